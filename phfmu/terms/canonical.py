"""From expressions of a declaration to canonical terms: symbols replaced by those of a pool, and where each one lives."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import Any

import casadi as ca

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import ACCOUNT, PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import Value, Variable, time
from phfmu.terms.located import RowAt, ValueAt
from phfmu.terms.term import Pair, Term, TermKind


class Locator:
    """The place of each scalar symbol of a model, by its element hash."""

    def __init__(self, model: PHDAE, pairs: Sequence[Pair]):
        self.where: dict[int, ValueAt] = {time.element_hash(): ValueAt(Value.TIME, 0)}
        owners = ((Value.STATE, model.states), (Value.ALGEBRAIC, model.algebraics), (Value.PARAMETER, model.parameters))
        for kind, variables in owners:
            for i, s in enumerate(s for v in variables for s in ca.vertsplit(v.sx)):
                self.where[s.element_hash()] = ValueAt(kind, i)
        for i, z in enumerate(z for v in model.states for z in ca.vertsplit(v.z)):
            self.where[z.element_hash()] = ValueAt(Value.COSTATE, i)
        for i, pair in enumerate(pairs):
            self.where[pair.port.u[pair.j].element_hash()] = ValueAt(Value.INPUT, i)

    def also(self, symbols: ca.SX, kind: Value, indices: Iterable[int]) -> Locator:
        """This locator with the entries of `symbols` besides."""
        out = Locator.__new__(Locator)
        out.where = dict(self.where)
        for s, i in zip(ca.vertsplit(symbols), indices, strict=True):
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
        return [self.find(s, variable.name) for s in ca.vertsplit(variable.sx)]


def canonical(exprs: Sequence[ca.SX], locator: Locator, context: str, extra: Sequence[ca.SX] = ()) -> tuple:
    """Replace the symbols of `exprs` by pool symbols; returns (new exprs, key, local symbols, indices).

    `extra` symbols (scalars) are listed first even if they do not occur.
    """
    symbols: list[ca.SX] = []
    seen: set[int] = set()
    for s in [*extra, *ca.symvar(ca.vertcat(*(ca.vec(e) for e in exprs)))]:
        if s.element_hash() not in seen:
            seen.add(s.element_hash())
            symbols.append(s)
    by_kind: dict[Value, list[tuple[ca.SX, int]]] = {kind: [] for kind in Value}
    for s in symbols:
        found = locator.find(s, context)
        by_kind[found.kind].append((s, found.index))
    by_kind = {kind: found for kind, found in by_kind.items() if found}
    local = {kind: ca.SX.sym(kind.value, len(found)) for kind, found in by_kind.items()}
    index = {kind: tuple(i for _, i in found) for kind, found in by_kind.items()}
    olds = [s for found in by_kind.values() for s, _ in found]
    news = [local[kind][j] for kind, found in by_kind.items() for j in range(len(found))]
    replaced = ca.substitute([ca.SX(e) for e in exprs], olds, news) if olds else [ca.SX(e) for e in exprs]
    text = ca.Function("f", list(local.values()), replaced, {"allow_free": True}).serialize()
    return replaced, (tuple((kind, len(v)) for kind, v in index.items()), text), local, index


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


def components(pattern: ca.SX) -> list[list[int]]:
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
    """Place of the member `owner`, 0 for none."""
    return members.index(owner) if owner in members else 0


def component(members: Sequence[str], i: int) -> int:
    """Place of the member whose account the member at place i is, else i itself."""
    return member(members, members[i].partition(ACCOUNT)[0]) if ACCOUNT in members[i] else i


def scalars(matrix: ca.SX) -> list[ca.SX]:
    """The structural nonzeros of a matrix, column by column."""
    entries: list[Any] = matrix.nonzeros()
    return [ca.SX(e) for e in entries]
