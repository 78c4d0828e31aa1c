"""Canonical terms of expressions of a declaration: symbols replaced by those of a pool, and the place of each one."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import ValueKind, Variable, time
from phfmu.terms.located import RowAt, ValueAt
from phfmu.terms.term import PortPair, Term, TermKind


class Locator:
    """The place of each scalar symbol of a model, by its element hash."""

    def __init__(self, model: PHDAE, pairs: Sequence[PortPair]):
        #: terms made of expressions, by the form of these: once per kind
        self.known: dict[Hashable, Any] = {}
        self.where: dict[int, ValueAt] = {time.element_hash(): ValueAt(ValueKind.TIME, 0)}
        owners = (
            (ValueKind.STATE, model.states),
            (ValueKind.ALGEBRAIC, model.algebraics),
            (ValueKind.PARAMETER, model.parameters),
        )
        for kind, variables in owners:
            for i, s in enumerate(s for v in variables for s in scalars(v.sx)):
                self.where[s.element_hash()] = ValueAt(kind, i)
        for i, z in enumerate(z for v in model.states for z in scalars(v.z)):
            self.where[z.element_hash()] = ValueAt(ValueKind.COSTATE, i)
        for i, pair in enumerate(pairs):
            self.where[pair.port.u[pair.j].element_hash()] = ValueAt(ValueKind.INPUT, i)

    def also(self, symbols: ca.SX, kind: ValueKind, indices: Iterable[int]) -> Locator:
        """This locator with the entries of `symbols` besides."""
        out = Locator.__new__(Locator)
        out.where, out.known = dict(self.where), self.known
        for s, i in zip(scalars(symbols), indices, strict=True):
            out.where[s.element_hash()] = ValueAt(kind, i)
        return out

    def find(self, symbol: ca.SX, context: str) -> ValueAt:
        """The place of a scalar symbol.  DeclarationError names the symbol and the entry it stands in."""
        try:
            return self.where[symbol.element_hash()]
        except KeyError:
            raise DeclarationError(
                context,
                f"symbol '{symbol}' is not a state, algebraic variable, parameter or input of this model",
                "list its variable in the declaration",
                "symbol",
            ) from None

    def of(self, variable: Variable | Port) -> list[ValueAt]:
        return [self.find(s, variable.name) for s in scalars(variable.sx)]


@dataclass(frozen=True)
class Reading:
    """Expressions read as a function of their symbols, kind by kind.

    `form`: equal for expressions that differ in their symbols only;  `symbols`, `index`: per kind of value, in the order in
    which they are met.
    """

    form: Hashable
    symbols: dict[ValueKind, list[ca.SX]]
    index: dict[ValueKind, tuple[int, ...]]


def read(exprs: Sequence[ca.SX], locator: Locator, context: str, extra: Sequence[ca.SX] = ()) -> Reading:
    """The form of `exprs` and where their symbols live; `extra` symbols (scalars) are listed first even if they do not occur."""
    found: dict[ValueKind, dict[int, ca.SX]] = {}
    plain = _symbols(exprs)
    f = ca.Function("f", [], exprs, {"allow_free": True}) if plain is None else None
    met: Any = plain if f is None else f.free_sx()  # in the order of the operations that read them
    free = [locator.find(s, context) for s in met]
    for s, at in zip([*extra, *met], [*(locator.find(s, context) for s in extra), *free], strict=True):
        found.setdefault(at.kind, {}).setdefault(at.index, s)
    found = {kind: found[kind] for kind in ValueKind if kind in found}
    symbols = {kind: list(of.values()) for kind, of in found.items()}
    index = {kind: tuple(of) for kind, of in found.items()}
    counts = tuple((kind, len(of)) for kind, of in symbols.items())
    places = tuple((at.kind, index[at.kind].index(at.index)) for at in free)
    shapes = tuple((*e.shape, *map(tuple, e.sparsity().get_triplet())) if e.numel() != 1 else e.nnz() for e in exprs)
    return Reading((counts, places, shapes, None if f is None else _operations(f)), symbols, index)


def _symbols(exprs: Sequence[ca.SX]) -> list[ca.SX] | None:
    """The entries of one expression that are symbols all, as a mass and states that are observed are; None of others."""
    return scalars(exprs[0]) or None if len(exprs) == 1 and exprs[0].is_valid_input() else None


def _operations(f: ca.Function) -> tuple[Hashable, ...]:
    """The operations of a function, one after another, with their places and constants."""
    out: list[Hashable] = []
    for k in range(f.n_instructions()):
        op = f.instruction_id(k)
        if op == ca.OP_CONST:
            out.append((float(f.instruction_constant(k)).hex(), *f.instruction_output(k)))
        else:
            out.append((op, *f.instruction_input(k), -1, *f.instruction_output(k)))
    return tuple(out)


def canonical(exprs: Sequence[ca.SX], locator: Locator, context: str, extra: Sequence[ca.SX] = ()) -> tuple:
    """Replace the symbols of `exprs` by pool symbols; returns (new exprs, key, local symbols, indices).

    `extra` symbols (scalars) are listed first even if they do not occur.  Expressions of one form share the pool.
    """
    exprs = [e if isinstance(e, ca.SX) else ca.SX(e) for e in exprs]
    found = read(exprs, locator, context, extra)
    known = locator.known.get(found.form)
    if known is None:
        local = {kind: ca.SX.sym(kind.value, len(of)) for kind, of in found.symbols.items()}
        olds = [s for of in found.symbols.values() for s in of]
        news = [local[kind][j] for kind, of in found.symbols.items() for j in range(len(of))]
        replaced = ca.substitute(exprs, olds, news) if olds else exprs
        text = ca.Function("f", list(local.values()), replaced, {"allow_free": True}).serialize()
        key = (tuple((kind, len(of)) for kind, of in found.symbols.items()), text)
        known = locator.known[found.form] = (replaced, key, local)
    return *known, found.index


def alike(
    given: Sequence[ca.SX],
    rows: Sequence[RowAt],
    locator: Locator,
    context: str,
    make: Callable[[], list[Term]],
    owner: int = 0,
    also: Hashable = None,
) -> list[Term]:
    """The terms that follow from `given` and the rows that they may have: made once per form of these, then placed where the
    symbols and rows of others are.  `also`: what else they follow from.
    """  # fmt: skip
    found = read(given, locator, context)
    key = make.__qualname__, found.form, also, tuple((r.kind, rows.index(r)) for r in rows)
    known = locator.known.get(key)
    if known is None:
        terms = make()
        locator.known[key] = [
            (
                t,
                {kind: [found.index[kind].index(i) for i in of] for kind, of in t.index.items()},
                [rows.index(r) for r in t.rows],
            )
            for t in terms
        ]
        return terms
    return [
        replace(
            t, index={kind: tuple([found.index[kind][j] for j in of]) for kind, of in places.items()},
            rows=tuple([rows[j] for j in at]), owner=owner,
        )
        for t, places, at in known
    ]  # fmt: skip


def make_term(
    kind: TermKind,
    exprs: dict[str, ca.SX],
    locator: Locator,
    context: str,
    *,
    rows: Iterable[RowAt] = (),
    owner: int = 0,
    extra: Sequence[ca.SX] = (),
    form: Hashable = None,
) -> Term:
    """A canonical term from named expressions; `form` joins the key."""
    rows = tuple(rows)
    new, key, local, index = canonical(list(exprs.values()), locator, context, extra)
    full_key = (kind, form, tuple(r.kind for r in rows), *key)
    return Term(kind, full_key, local, index, dict(zip(exprs, new, strict=True)), rows, owner, form)


def components(pattern: ca.SX | ca.DM) -> list[list[int]]:
    """Index sets of the connected components of a square matrix's sparsity (structural zeros only)."""
    n = pattern.shape[0]
    parent = list(range(n))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    used = set()
    rows, cols = pattern.sparsity().get_triplet()
    for r, c in zip(rows, cols, strict=True):
        parent[root(r)] = root(c)
        used.update((r, c))
    sets: dict[int, list[int]] = {}
    for i in sorted(used):
        sets.setdefault(root(i), []).append(i)
    return list(sets.values())


def member(members: Sequence[str], owner: str) -> int:
    """Place of the member `owner`, 0 for none; of terms, `Terms.member` looks it up."""
    return members.index(owner) if owner in members else 0


def scalars(matrix: ca.SX) -> list[ca.SX]:
    """The structural nonzeros of a matrix, column by column."""
    entries: list[Any] = matrix.nonzeros()
    return entries
