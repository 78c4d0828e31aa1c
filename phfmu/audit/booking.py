"""Names of the energies of a run in the audit: components, ports and the junctions where these meet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from phfmu.audit.kinds import Quality

#: the part of a junction's energy that projecting impulses take from the states of a composed model: a loss, or nothing
PROJECTION = "projection"


@dataclass(frozen=True, slots=True)
class PortKey:
    """One effort/flow pair, one column of `Steps.pairs`; `index` numbers the pairs of a vector port from 1."""

    component: str
    port: str
    index: int | None = None
    junction: str | None = None
    quality: Quality = Quality.EXACT


@dataclass(frozen=True, slots=True)
class PartKey:
    """One part of the energy that a coupling makes at a junction, one column of `Steps.works`."""

    junction: str
    part: str


@dataclass(frozen=True, slots=True)
class TermKey:
    """One term of H, which stores, or part of R, which dissipates; one column of `Steps.terms`."""

    component: str
    term: str
    stores: bool


@dataclass(frozen=True)
class Booking:
    """The meaning of the columns of `Steps`: c components, q scalar ports; the junctions follow from the ports.

    `silent`: components that tell nothing of their energy, neither by ports nor by books (foreign units).
    `loose`: the coupling does not claim that junctions create no energy.
    `parts`: of junctions that have more than one, what their energy is the sum of.
    `terms`: what of H and R is told by itself.
    `constants`: by component what of its H no state enters [J], () where that is nothing.
    """

    components: tuple[str, ...]
    ports: tuple[PortKey, ...] = ()
    silent: frozenset[str] = frozenset()
    loose: bool = False
    parts: tuple[PartKey, ...] = ()
    constants: tuple[float, ...] = ()
    terms: tuple[TermKey, ...] = ()

    @cached_property
    def junctions(self) -> dict[str, list[int]]:
        """Port columns of each junction, in order of first appearance."""
        members: dict[str, list[int]] = {}
        for column, port in enumerate(self.ports):
            if port.junction is not None:
                members.setdefault(port.junction, []).append(column)
        return members

    @cached_property
    def divided(self) -> dict[str, list[int]]:
        """Columns of the parts of each junction that has parts."""
        columns: dict[str, list[int]] = {}
        for column, key in enumerate(self.parts):
            columns.setdefault(key.junction, []).append(column)
        return columns

    @cached_property
    def external(self) -> list[tuple[int, float]]:
        """Port columns through which energy enters the balance, and the sign with which it does."""
        inside = set(self.components)
        return [
            (column, 1.0 if port.component in inside else -1.0)
            for column, port in enumerate(self.ports)
            if (port.component in inside) == (port.junction is None)
        ]

    @cached_property
    def owned(self) -> list[list[int]]:
        """Port columns of each component."""
        columns: dict[str, list[int]] = {name: [] for name in self.components}
        for column, port in enumerate(self.ports):
            if port.component in columns:
                columns[port.component].append(column)
        return list(columns.values())

    @cached_property
    def scalars(self) -> dict[tuple[str, str], list[int]]:
        """Port columns of each port (component, port)."""
        columns: dict[tuple[str, str], list[int]] = {}
        for column, port in enumerate(self.ports):
            columns.setdefault((port.component, port.port), []).append(column)
        return columns

    @cached_property
    def estimated(self) -> frozenset[str]:
        return frozenset(port.component for port in self.ports if port.quality == Quality.ESTIMATED)

    def quality(self, component: str) -> Quality:
        """exact, estimated (a quadrature of its ports' power) or none."""
        if component in self.silent:
            return Quality.SILENT
        return Quality.ESTIMATED if component in self.estimated else Quality.EXACT

    @cached_property
    def exact(self) -> list[bool]:
        """Components that are judged."""
        return [self.quality(name) is Quality.EXACT for name in self.components]
