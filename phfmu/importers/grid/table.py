"""One neutral table of a grid: buses, lines, transformers, loads, shunts, generators, dynamic data.

Values are those of power flow programs: per unit of `base` MVA and of the voltages of the buses, powers in MW and Mvar, angles
in rad; dynamic data are per unit of the machine.  A reader makes the table, `phfmu.components.grids` makes a network of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import inf

from phfmu.words import first_few, meant

#: kinds of buses: what is known there
LOAD, VOLTAGE, SLACK, ISOLATED = 1, 2, 3, 4


class GridError(ValueError):
    """Data of a grid that cannot be read, or contradict themselves; the message has a line for each problem."""

    def __init__(self, name: str, problems: Iterable[str]):
        self.problems = tuple(problems)
        super().__init__("\n".join(f"{name}: {p}" for p in self.problems))


@dataclass(frozen=True)
class Bus:
    """A bus of rated voltage kv [kV rms, line to line]; vm [pu], va [rad]: voltage of the solved case; kind: as above."""

    number: int
    name: str
    kv: float
    kind: int
    vm: float
    va: float


@dataclass(frozen=True)
class Line:
    """A pi line or, with x < 0, a series capacitor; b: charging of the whole line; ends: g and b of shunts at i and at j."""

    i: int
    j: int
    circuit: str
    r: float
    x: float
    b: float
    ends: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    on: bool = True


@dataclass(frozen=True)
class Transformer:
    """Two windings: ratio tap:1 with the phase shift [rad] at i, then r + jx on the side of j; g, b: magnetising branch at i."""

    i: int
    j: int
    circuit: str
    r: float
    x: float
    tap: float = 1.0
    shift: float = 0.0
    g: float = 0.0
    b: float = 0.0
    group: str = ""
    on: bool = True


@dataclass(frozen=True)
class Demand:
    """A load: p, q [MW, Mvar] at constant power, ip, iq at constant current and yp, yq at constant admittance, at 1 pu."""

    bus: int
    id: str
    p: float
    q: float
    ip: float = 0.0
    iq: float = 0.0
    yp: float = 0.0
    yq: float = 0.0
    on: bool = True


@dataclass(frozen=True)
class Shunt:
    """g [MW] and b [Mvar] that it takes and delivers at 1 pu."""

    bus: int
    id: str
    g: float
    b: float
    on: bool = True


@dataclass(frozen=True)
class Generator:
    """A machine or plant that delivers p [MW], q [Mvar]; v [pu]: voltage held at the bus `holds`; base [MVA].

    r, x [pu of its base]: resistance of the stator, and reactance behind which its voltage is constant.
    q_limits: the least and the most q [Mvar].
    """

    bus: int
    id: str
    p: float
    q: float
    v: float
    holds: int
    base: float
    r: float = 0.0
    x: float = 0.0
    on: bool = True
    q_limits: tuple[float, float] = (-inf, inf)


@dataclass(frozen=True)
class Dynamics:
    """Data of a model (GENROU, SEXS, ..) of the unit `id` at `bus`, by name; `where` they stand."""

    bus: int
    id: str
    model: str
    values: Mapping[str, float] = field(default_factory=dict)
    where: str = ""


@dataclass(frozen=True)
class Grid:
    """A grid as data.  `unused`: lines about what the source has besides."""

    name: str
    base: float
    frequency: float
    buses: tuple[Bus, ...]
    lines: tuple[Line, ...] = ()
    transformers: tuple[Transformer, ...] = ()
    demands: tuple[Demand, ...] = ()
    shunts: tuple[Shunt, ...] = ()
    generators: tuple[Generator, ...] = ()
    dynamics: tuple[Dynamics, ...] = ()
    unused: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if problems := list(_problems(self)):
            raise GridError(self.name, problems)

    def __repr__(self) -> str:
        on = sum(g.on for g in self.generators)
        return (
            f"<Grid {self.name}: {len(self.buses)} buses, {len(self.lines)} lines, {len(self.transformers)} transformers, "
            f"{len(self.demands)} loads, {on} generators in service, {len(self.dynamics)} sets of dynamic data>"
        )

    @property
    def bus(self) -> dict[int, Bus]:
        """The buses by number."""
        return {b.number: b for b in self.buses}

    @property
    def slack(self) -> Bus:
        """The bus that fixes the angle."""
        return next(b for b in self.buses if b.kind == SLACK)


def _problems(grid: Grid) -> Iterable[str]:
    numbers = {b.number for b in grid.buses}
    if not grid.base > 0 or not grid.frequency > 0:
        yield f"base {grid.base:g} MVA and frequency {grid.frequency:g} Hz must be positive"
    if len(numbers) < len(grid.buses):
        seen: set[int] = set()
        twice = [str(b.number) for b in grid.buses if b.number in seen or seen.add(b.number)]
        yield f"bus {first_few(twice)} is there twice; give each bus a number of its own"
    for b in grid.buses:
        if b.kind not in (LOAD, VOLTAGE, SLACK, ISOLATED):
            yield f"bus {b.number}: type {b.kind} is none of 1 (load), 2 (voltage held), 3 (slack), 4 (isolated)"
        if not b.kv > 0:
            yield f"bus {b.number}: base voltage {b.kv:g} kV must be positive"
        if b.kind != ISOLATED and not 0.0 < b.vm < 2.0:
            yield f"bus {b.number}: voltage {b.vm:g} pu; give that of the solved case, near 1"
    slacks = [b.number for b in grid.buses if b.kind == SLACK]
    if len(slacks) != 1:
        yield f"{len(slacks)} slack buses (type 3){f': {first_few(list(map(str, slacks)))}' if slacks else ''}; there must be one"
    words = [str(n) for n in numbers]
    for what, rows in (
        ("line", grid.lines), ("transformer", grid.transformers), ("load", grid.demands), ("shunt", grid.shunts),
        ("generator", grid.generators), ("dynamic data of", grid.dynamics),
    ):  # fmt: skip
        for row in rows:
            named = f"{row.i}-{row.j} '{row.circuit}'" if isinstance(row, Line | Transformer) else f"'{row.id}'"
            label = row.model + " of" if isinstance(row, Dynamics) else what
            for end in (row.i, row.j) if isinstance(row, Line | Transformer) else (row.bus,):
                if end not in numbers:
                    yield f"{label} {named}: no bus {end}; {meant(str(end), words)}"
    for t in grid.transformers:
        if not t.tap > 0:
            yield f"transformer {t.i}-{t.j} '{t.circuit}': ratio {t.tap:g} must be positive"
    for g in grid.generators:
        if g.on and not g.base > 0:
            yield f"generator '{g.id}' at bus {g.bus}: base {g.base:g} MVA must be positive"
