"""Tables and picture of docs/results/multibody.md: mechanisms beside MuJoCo, exudyn, SUNDIALS IDA and OpenSim."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pages import PageBlock, nothing, table
from peers import cheapest, draw_panels, measured_in_turns, remarks

from phfmu.studies.bench import machine
from phfmu.studies.bench.mechanisms import exudyn_models, ida, mujoco_models, opensim_models
from phfmu.studies.bench.mechanisms.case import MechanismCase
from phfmu.studies.bench.mechanisms.cases import CASES, IFTOMM
from phfmu.studies.bench.precision.candidate import Candidate
from phfmu.studies.bench.precision.work_precision import WorkPrecisionTable

TURNS = 5  # of which the median counts
#: errors at which costs are compared
LEVELS = (1e-5, 1e-7, 1e-9, 1e-10)
#: columns of the costs: a name and the methods of which the cheapest counts
COLUMNS = {
    "phfmu": ("phfmu",),
    "MuJoCo": ("MuJoCo",),
    "exudyn, constraints": ("exudyn generalized", "exudyn trapezoidal"),
    "exudyn, tree": ("exudyn tree",),
    "SUNDIALS IDA": ("SUNDIALS",),
}


Peers = tuple[Callable[[MechanismCase], Iterator[Candidate]], ...]
PROGRAMS: Peers = (mujoco_models.candidates, exudyn_models.candidates, ida.candidates)


@cache
def measured(iftomm: bool = False) -> tuple[dict[str, tuple[MechanismCase, WorkPrecisionTable]], str]:
    """All cases, each with its methods in turns; the machine with its load."""
    peers = (opensim_models.candidates,) if iftomm else PROGRAMS

    def methods(case: MechanismCase) -> Iterator[Candidate]:
        case.solve_reference()
        yield from case.own()
        for peer in peers:
            yield from peer(case)

    return measured_in_turns(IFTOMM if iftomm else CASES, methods, TURNS)


def multibody_peers() -> PageBlock:
    """Errors of positions and CPU time of all methods and settings, the first table of the page, and its picture."""
    return _rows(False, _draw)


def multibody_peers_iftomm() -> PageBlock:
    """The problems A01 to A04 of the IFToMM's library beside OpenSim."""
    return _rows(True)


def _rows(iftomm: bool, draw: Callable[[], Sequence[Path]] = nothing) -> PageBlock:
    found, about = measured(iftomm)
    rows = [
        [name, r.method, r.setting, f"{1e3 * r.cpu:.3g}", r.judged.errors[0]]
        for name, (_, result) in found.items()
        for r in result.rows
    ]
    sure = ", ".join(f"{name} {case.uncertainty:.0e}" for name, (case, _) in found.items())
    notes = (*remarks(found), f"distance of the references at relative tolerances of 1e-12 and 1e-13: {sure}", about)
    head = ["mechanism", "method", "setting", "ms/s", "error, m"]
    return table(head, rows, ".1e", notes=(*notes, machine.versions()), draw=draw)


def multibody_peers_equal() -> PageBlock:
    """Costs at equal errors in ms of CPU per second, and how many times those of phfmu they are."""
    found, _ = measured()
    rows: list[list[Any]] = []
    for name, (_, result) in found.items():
        by_column = {c: [r for r in result.rows if r.method.startswith(starts)] for c, starts in COLUMNS.items()}
        for level in LEVELS:
            own, *others = (cheapest(of, level) if of else None for of in by_column.values())
            cells = [
                "" if not of else "not reached" if cost is None else f"{1e3 * cost:.3g}{_times(cost, own)}"
                for of, cost in zip(list(by_column.values())[1:], others, strict=True)
            ]
            rows.append([name, f"{level:.0e}", "not reached" if own is None else f"{1e3 * own:.3g}", *cells])
    return table(["mechanism", "error, m", *COLUMNS], rows)


def _times(cost: float, own: float | None) -> str:
    return "" if own is None else f" ({cost / own:.2g})"


def _draw() -> Sequence[Path]:
    found, about = measured()
    shown = [
        (name, case, result, f"error of positions in m at t = {case.stop:g} s")
        for name, (case, result) in found.items()
        if len(result.methods()) > 2
    ]
    return draw_panels("multibody.png", shown, 3, (4.0, 3.9), f"{about}\n{machine.versions()}")
