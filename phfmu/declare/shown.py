"""How a declaration shows itself: one line, and a table for notebooks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

from phfmu.declare.port import Port
from phfmu.declare.variable import Variable
from phfmu.html import grid
from phfmu.words import counted

MOST = 4  # numbers of a vector that are shown


class Shown(Protocol):
    """What of a declaration is shown."""

    @property
    def name(self) -> str: ...
    @property
    def description(self) -> str: ...
    @property
    def states(self) -> tuple[Variable, ...]: ...
    @property
    def algebraics(self) -> tuple[Variable, ...]: ...
    @property
    def parameters(self) -> tuple[Variable, ...]: ...
    @property
    def ports(self) -> tuple[Port, ...]: ...
    @property
    def observables(self) -> tuple[Any, ...]: ...
    @property
    def state_events(self) -> tuple[Any, ...]: ...


def line(d: Shown) -> str:
    """Name and sizes."""
    sizes = (
        (sum(v.n for v in d.states), "state"),
        (sum(v.n for v in d.algebraics), "algebraic variable"),
        (len([v for v in d.parameters if not v.signal]), "parameter"),
        (len([p for p in d.ports if p.external]), "port"),
        (len(d.state_events), "state event"),
    )
    return f"PHDAE {d.name}: {', '.join(counted(n, noun) for n, noun in sizes if n) or 'empty'}"


def table(d: Shown) -> str:
    """Its variables, ports and observables with units and starts."""
    return grid(line(d), ("", "name", "unit", "start", ""), rows(d), d.description)


def rows(d: Shown) -> Iterator[tuple[str, str, str, str, str]]:
    """(kind, name, unit, start, description)."""
    for kind, variables in (("state", d.states), ("algebraic", d.algebraics), ("parameter", d.parameters)):
        for v in variables:
            yield "signal input" if v.signal else kind, v.name, _unit(v.unit), _start(v), v.description
    for p in (p for p in d.ports if p.external):
        given, found = p.input_names()[0].partition("[")[0], p.output_names()[0].partition("[")[0]
        units = f"{p.input_unit}, {p.output_unit}"
        yield (
            "port",
            p.name,
            units,
            "",
            f"{given} given, {found} found" + (f"; {p.description}" if p.description else ""),
        )
    for o in d.observables:
        yield "observable", o.name, _unit(o.unit), "", o.description


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _start(v: Variable) -> str:
    numbers = ", ".join(f"{x:.6g}" for x in v.start[:MOST])
    return numbers + (", .." if v.n > MOST else "")
