"""Fault studies of grids: a scene that begins in the operating point, with faults at buses and lines that trip."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from phfmu import Event, Scene
from phfmu.components.grids.model import GridModel, Plants, grid_model
from phfmu.importers.grid import Grid, GridError

#: resistance of a fault in per unit where none is given
RESISTANCE = 1e-3


@dataclass(frozen=True)
class Fault:
    """Three-phase fault at a bus from `begin` to `end` [s], of R [pu] in each phase to ground."""

    bus: int
    begin: float
    end: float
    R: float = RESISTANCE


@dataclass(frozen=True)
class Trip:
    """A line whose poles open at their next current zeros from `t` [s] on.

    None: from the end of the first fault on.
    """

    branch: str
    t: float | None = None


def fault_of(text: str) -> Fault:
    """A fault from `bus7:0.1:0.18` or `bus7:0.1:0.18:0.001` (R in per unit); ValueError for other words."""
    m = re.fullmatch(r"(?:bus)?(\d+):([^:]+):([^:]+)(?::([^:]+))?", text)
    try:
        if m is None:
            raise ValueError
        fault = Fault(int(m[1]), float(m[2]), float(m[3]), float(m[4] or RESISTANCE))
    except ValueError:
        raise ValueError(f"fault '{text}': expected bus:begin:end or bus:begin:end:R (bus7:0.1:0.18)") from None
    if not (0 <= fault.begin < fault.end and fault.R > 0):
        raise ValueError(f"fault '{text}': it must begin at 0 or later and before its end, and R [pu] must be positive")
    return fault


def trip_of(text: str) -> Trip:
    """A trip from `line5-7` or `line5-7:0.18`; ValueError for other words."""
    branch, mark, time = text.partition(":")
    try:
        found = Trip(branch, float(time) if mark else None)
    except ValueError:
        raise ValueError(f"trip '{text}': expected branch or branch:time (line5-7:0.18)") from None
    if found.t is not None and not 0.0 <= found.t < inf:
        raise ValueError(f"trip '{text}': its time must be 0 or later")
    return found


def grid_scene(
    grid: Grid,
    *,
    faults: Sequence[Fault] = (),
    trips: Sequence[Trip] = (),
    plants: Plants = "refuse",
    controls: bool = True,
    q_limits: bool = False,
    saturation: bool = False,
    stop: float = 1.0,
    step: float = 5e-5,
) -> Scene:
    """The grid in its operating point, with the faults and trips as events; the scene's notes are the account of the import.

    plants, controls, q_limits, saturation: those of `grid_model`;  stop, step [s]: of the run
    GridError for data without parts; NoOperatingPoint where there is none.
    """
    ends = [f.end for f in faults]
    if open_ended := [t.branch for t in trips if t.t is None and not ends]:
        raise ValueError(f"trip of {open_ended[0]}: say when ({open_ended[0]}:0.2), as there is no fault that ends")
    buses = list(dict.fromkeys(f.bus for f in faults))
    breakers = [t.branch for t in trips]
    model = grid_model(
        grid,
        plants=plants,
        faults=buses,
        breakers=breakers,
        controls=controls,
        q_limits=q_limits,
        saturation=saturation,
    )
    events = [e for f in faults for e in _events(model, f)]
    events += [
        Event(min(ends) if t.t is None else t.t, f"{model.branch(t.branch)}.command", 0.0)
        for t in trips
    ]  # fmt: skip
    net = model.started()
    net.description = f"{grid.name}, {len(grid.buses)} buses, from its operating point"
    return Scene(
        net.name,
        net,
        stop,
        step,
        tuple(sorted(events, key=lambda e: e.t)),
        notes=tuple(_account(model)),
        restart=2 if faults else 0,  # what a fault discharges in microseconds rings at Gauss nodes
    )


def _events(model: GridModel, fault: Fault) -> tuple[Event, Event]:
    name = f"fault{fault.bus}.G"
    if fault.bus not in model.grid.bus:
        raise GridError(model.grid.name, [f"no bus {fault.bus} for a fault"])
    return Event(fault.begin, name, model.fault_conductance(fault.bus, fault.R)), Event(fault.end, name, 0.0)


def shortened(lines: Sequence[str], most: int = 4) -> list[str]:
    """The first lines, and how many more there are."""
    more = len(lines) - most
    return [*lines[:most], *([f".. and {more} more of that kind"] if more > 0 else [])]


def _account(model: GridModel) -> list[str]:
    """Residual of the operating point, data of the file that are not used, and assumptions, a line each."""
    p = model.point
    return [
        f"operating point: {p.iterations} iterations, residual {p.residual:.1e} of the rates",
        *shortened(model.beyond()),
        *model.report.beside(),
        *model.report.notes,
    ]
