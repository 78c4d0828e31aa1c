"""Terms: canonical local functions with the indices they act on, and all there are of a declaration.

Two terms that differ only in their symbols get the same key, so a scheme discretises each kind of term once and
the plan holds one kernel with many instances.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.energy import EnergyKind
from phfmu.declare.phdae import ACCOUNT, PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import ValueKind
from phfmu.terms.located import Constant, RowAt

#: no symbols
EMPTY = ca.SX(0, 1)

Finding = TypeVar("Finding")


@dataclass(frozen=True)
class PortPair:
    """One scalar power-port pair: `port` entry `j`; `owner` is its member id."""

    port: Port
    j: int
    owner: int


@dataclass(frozen=True, eq=False)
class TermKind:
    """A kind of term; a technique that adds terms of its own brings their kind."""

    name: str


ENERGY = TermKind("energy")  # a summand of H
JOINT = TermKind("joint energy")  # all of H of a member
CLOSED = TermKind("closed-form pair")
FLOW = TermKind("flow")  # a part of (J - R) z + B u
CONSTRAINT = TermKind("constraint")
SOURCE = TermKind("source")
OBSERVABLE = TermKind("observable")
MASS = TermKind("mass")  # a constant diagonal entry of E
MASS_BLOCK = TermKind("mass block")  # a full or state-dependent block of E


@dataclass(frozen=True)
class EnergyForm:
    """The form of an energy term; `metric`: the weight of each of its states in a correction of a general one."""

    kind: EnergyKind
    metric: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Term:
    """A canonical local function.

    key:    equal keys = equal functions
    form:   the variant of terms of one kind with equal functions, a value of a type of the module that makes them
    local:  per kind of value the local symbols (SX column), in the order of `index`
    index:  per kind of value the global indices
    data:   kind-specific expressions in the local symbols
    rows:   of each output
    """

    kind: TermKind
    key: tuple[Any, ...]
    local: dict[ValueKind, ca.SX]
    index: dict[ValueKind, tuple[int, ...]]
    data: dict[str, Any]
    rows: tuple[RowAt, ...] = ()
    owner: int = 0
    form: Hashable = None

    def form_of(self, kind: type[Finding]) -> Finding:
        """The form of the term, which is of this type."""
        assert isinstance(self.form, kind)
        return self.form

    def symbols(self, kind: ValueKind) -> ca.SX:
        """Local symbols of a kind, none where it has none."""
        return self.local.get(kind, EMPTY)

    def indices(self, kind: ValueKind) -> tuple[int, ...]:
        """Global indices of a kind."""
        return self.index.get(kind, ())


def by_kind(terms: Iterable[Term]) -> list[list[Term]]:
    """The terms of each kind, which have equal keys."""
    found: dict[tuple[Any, ...], list[Term]] = {}
    for t in terms:
        found.setdefault(t.key, []).append(t)
    return list(found.values())


def gathered(values: NDArray[np.float64] | ca.SX, terms: Sequence[Term], kind: ValueKind) -> Any:
    """Columns, one for each of some terms of equal key, of the entries of `values` (of one kind) on which they act."""
    where = np.array([t.indices(kind) for t in terms], np.int64).reshape(len(terms), -1)
    if isinstance(values, ca.SX):
        return (
            ca.reshape(values[where.ravel().tolist()], where.shape[1], len(terms))
            if where.size
            else ca.SX(*where.T.shape)
        )
    return values[where.T]


@dataclass
class Terms:
    """All terms of a declaration, its constant entries, and sizes.

    `findings`: what techniques have found out about these terms, by the type in which each keeps it.
    """

    model: PHDAE
    n1: int = 0
    na: int = 0
    np: int = 0
    pairs: list[PortPair] = field(default_factory=list)
    nu: int = 0
    #: pair -> the algebraic variable that feeds it
    bound: dict[int, int] = field(default_factory=dict)
    members: list[str] = field(default_factory=list)
    terms: list[Term] = field(default_factory=list)
    constants: list[Constant] = field(default_factory=list)
    observable_names: list[str] = field(default_factory=list)
    findings: Mapping[type, Any] = field(default_factory=dict)

    def of(self, *kinds: TermKind) -> list[Term]:
        """Terms of these kinds."""
        return [t for t in self.terms if t.kind in kinds]

    def found(self, what: type[Finding]) -> Finding:
        """The finding of this type; the empty one where there is none."""
        return self.findings[what] if what in self.findings else what()

    def having(self, finding: object) -> Terms:
        """These terms with one finding more."""
        return replace(self, findings={**self.findings, type(finding): finding})

    def with_descriptor(self) -> set[int]:
        """States whose rows of E are not those of the identity."""
        return {r.index for t in self.of(MASS, MASS_BLOCK, CLOSED) for r in t.rows}

    def solved_costates(self) -> list[int]:
        """States of blocks of E: their costates solve E^T z = grad H."""
        return [r.index for t in self.of(MASS_BLOCK) for r in t.rows]

    def member(self, owner: str) -> int:
        """Place of the member `owner`, 0 for none."""
        return self._places.get(owner, 0)

    def component(self, i: int) -> int:
        """Place of the member whose account the member at place i is, else i itself."""
        name, account, _ = self.members[i].partition(ACCOUNT)
        return self.member(name) if account else i

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.members)}

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
