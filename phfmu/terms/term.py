"""From a declaration to canonical terms: small local functions plus the indices they act on.

Two terms that differ only in their symbols get the same key, so a scheme discretises each kind of term once and
the plan holds one kernel with many instances.  Value kinds used throughout:

    x state   z costate of a state   a algebraic variable   u input of a scalar port pair   p parameter   t time
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import Variable, time

#: no symbols
EMPTY = ca.SX(0, 1)


@dataclass(frozen=True)
class Pair:
    """One scalar power-port pair: `port` entry `j`; `owner` is its member id."""

    port: Port
    j: int
    owner: int


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of term; a technique that adds terms of its own brings their kind."""

    name: str


ENERGY = Kind("energy")  # a summand of H
JOINT = Kind("joint energy")  # all of H of a member
CLOSED = Kind("closed-form pair")
FLOW = Kind("flow")  # a part of (J - R) z + B u
CONSTRAINT = Kind("constraint")
SOURCE = Kind("source")
OBSERVABLE = Kind("observable")
MASS = Kind("mass")  # a constant diagonal entry of E
MASS_BLOCK = Kind("mass block")  # a full or state-dependent block of E


@dataclass(frozen=True, eq=False)
class Term:
    """A canonical local function.

    key:    equal keys = equal functions
    tag:    what tells terms of one kind apart beside their functions
    local:  per value kind the local symbols (SX column), in the order of `index`
    index:  per value kind the global indices
    data:   kind-specific expressions in the local symbols
    rows:   (row kind, index) of each output; row kinds x, a, y (pair output), o (observable)
    """

    kind: Kind
    key: tuple[Any, ...]
    local: dict[str, ca.SX]
    index: dict[str, tuple[int, ...]]
    data: dict[str, Any]
    rows: tuple[tuple[str, int], ...] = ()
    owner: int = 0
    tag: Any = None


@dataclass(frozen=True)
class Hidden:
    """`rows`: algebraic rows to differentiate;  `solved_by`: such a row -> the variable its own form determines."""

    rows: frozenset[int] = frozenset()
    solved_by: dict[int, int] = field(default_factory=dict)

    @property
    def checks(self) -> list[int]:
        """Rows that hold for consistent states only."""
        return sorted(self.rows - self.solved_by.keys())


@dataclass(frozen=True)
class Impulses:
    """Rows of bare nodes with an impulse pair and with a projecting end impulse; the states shifted at start and end."""

    pairs: tuple[int, ...]
    projected: tuple[int, ...]
    start_states: tuple[int, ...]
    end_states: tuple[int, ...]


@dataclass
class Terms:
    """All terms of a declaration, the constant triplets (row kind, row, source kind, source, value), and sizes."""

    model: PHDAE
    n1: int = 0
    na: int = 0
    np: int = 0
    pairs: list[Pair] = field(default_factory=list)
    nu: int = 0
    #: pair -> the algebraic variable that feeds it
    bound: dict[int, int] = field(default_factory=dict)
    members: list[str] = field(default_factory=list)
    terms: list[Term] = field(default_factory=list)
    constants: list[tuple[str, int, str, int, float]] = field(default_factory=list)
    solved_costates: tuple[int, ...] = ()
    velocity_of: dict[int, int] = field(default_factory=dict)
    #: velocities without mass, whose costates are unknowns of the two-level scheme
    light: tuple[int, ...] = ()
    closed_states: set[int] = field(default_factory=set)
    observable_names: list[str] = field(default_factory=list)
    hidden: Hidden = field(default_factory=Hidden)
    impulses: Impulses | None = None
    #: holonomic constraints at the start: multiplier -> natural size of Dg v; multipliers of those that rest
    speeds: dict[int, float] = field(default_factory=dict)
    resting: frozenset[int] = frozenset()

    def of(self, *kinds: Kind) -> list[Term]:
        """Terms of these kinds."""
        return [t for t in self.terms if t.kind in kinds]

    def with_descriptor(self) -> set[int]:
        """States whose rows of E are not those of the identity."""
        return {i for t in self.of(MASS, MASS_BLOCK, CLOSED) for _, i in t.rows}

    @cached_property
    def state_names(self) -> list[str]:
        return [n for v in self.model.states for n in v.names()]

    @cached_property
    def algebraic_names(self) -> list[str]:
        return [n for v in self.model.algebraics for n in v.names()]

    @cached_property
    def state_nominals(self) -> list[float]:
        return [v.nominal[j] for v in self.model.states for j in range(v.n)]

    @cached_property
    def algebraic_nominals(self) -> list[float]:
        return [v.nominal[j] for v in self.model.algebraics for j in range(v.n)]


class Locator:
    """Where each scalar symbol of a model lives: element hash -> (value kind, index)."""

    def __init__(self, model: PHDAE, pairs: Sequence[Pair]):
        self.where: dict[int, tuple[str, int]] = {time.element_hash(): ("t", 0)}
        for kind, variables in (("x", model.states), ("a", model.algebraics), ("p", model.parameters)):
            i = 0
            for v in variables:
                for s, z in zip(ca.vertsplit(v.sx), ca.vertsplit(v.z), strict=True):
                    self.where[s.element_hash()] = (kind, i)
                    if kind == "x":
                        self.where[z.element_hash()] = ("z", i)
                    i += 1
        for i, pair in enumerate(pairs):
            self.where[pair.port.u[pair.j].element_hash()] = ("u", i)

    def find(self, symbol: ca.SX, context: str) -> tuple[str, int]:
        """Kind and index of a scalar symbol; DeclarationError names the symbol and the entry it stands in."""
        try:
            return self.where[symbol.element_hash()]
        except KeyError:
            raise DeclarationError(
                context,
                f"symbol '{symbol}' is not a state, algebraic variable, parameter or input of this model",
                "list its variable in the declaration",
                "symbol",
            ) from None

    def of(self, variable: Variable | Port) -> list[tuple[str, int]]:
        return [self.find(s, variable.name) for s in ca.vertsplit(variable.sx)]


KINDS = ("x", "z", "a", "u", "p", "t")


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
    by_kind: dict[str, list[tuple[ca.SX, int]]] = {k: [] for k in KINDS}
    for s in symbols:
        kind, i = locator.find(s, context)
        by_kind[kind].append((s, i))
    local = {k: ca.SX.sym(k, len(found)) for k, found in by_kind.items() if found}
    index = {k: tuple(i for _, i in found) for k, found in by_kind.items() if found}
    olds = [s for k in KINDS for s, _ in by_kind[k]]
    news = [local[k][j] for k in KINDS for j in range(len(by_kind[k]))]
    replaced = ca.substitute([ca.SX(e) for e in exprs], olds, news) if olds else [ca.SX(e) for e in exprs]
    inputs = [local[k] for k in KINDS if k in local]
    text = ca.Function("f", inputs, replaced, {"allow_free": True}).serialize()
    return replaced, (tuple((k, len(v)) for k, v in index.items()), text), local, index


def make_term(
    kind: Kind,
    exprs: dict[str, ca.SX],
    locator: Locator,
    context: str,
    *,
    rows: Iterable[tuple[str, int]] = (),
    owner: int = 0,
    extra: Sequence[ca.SX] = (),
    tag: Any = None,
) -> Term:
    """A canonical term from named expressions; `tag` joins the key."""
    rows = tuple(rows)
    new, key, local, index = canonical(list(exprs.values()), locator, context, extra)
    full_key = (kind, tag, tuple(r[0] for r in rows), *key)
    return Term(kind, full_key, local, index, dict(zip(exprs, new, strict=True)), rows, owner, tag)


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


class WithIncrement(Locator):
    """A locator that files the increment symbols under the (otherwise unused) kind z."""

    def __init__(self, base: Locator):
        self.where = {k: (("z", v[1]) if v[0] == "d" else v) for k, v in base.where.items()}


def member(members: Sequence[str], owner: str) -> int:
    """Place of the member `owner`, 0 for none."""
    return members.index(owner) if owner in members else 0


def scalars(matrix: ca.SX) -> list[ca.SX]:
    """The structural nonzeros of a matrix, column by column."""
    entries: list[Any] = matrix.nonzeros()
    return [ca.SX(e) for e in entries]
