"""Tables and picture of docs/results/multibody.md: mechanisms beside MuJoCo, exudyn, SUNDIALS IDA and OpenSim."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pages import DOCS, Made, nothing, table

from phfmu.studies.bench import machine
from phfmu.studies.bench.candidate import Candidate
from phfmu.studies.bench.mechanisms import exudyn_models, ida, mujoco_models, opensim_models
from phfmu.studies.bench.mechanisms.case import Case
from phfmu.studies.bench.mechanisms.cases import CASES, IFTOMM
from phfmu.studies.bench.report import draw_lines
from phfmu.studies.bench.work_precision import Row, Table, cost_at, measure

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


Peers = tuple[Callable[[Case], Iterator[Candidate]], ...]
PROGRAMS: Peers = (mujoco_models.candidates, exudyn_models.candidates, ida.candidates)


@cache
def measured(iftomm: bool = False) -> tuple[dict[str, tuple[Case, Table]], str]:
    """All cases, each with its methods in turns; the machine with its load."""
    before, found, peers = machine.load(), {}, (opensim_models.candidates,) if iftomm else PROGRAMS
    for name, made in (IFTOMM if iftomm else CASES).items():
        case = made()
        print(f"{name}: reference", file=sys.stderr, flush=True)
        case.solve_reference()
        result = measure(case, [*case.own(), *(c for peer in peers for c in peer(case))], TURNS)
        for said in result.remarks:
            print(f"{name}: {said}", file=sys.stderr, flush=True)
        found[name] = (case, result)
    about = f"{machine.processor()}; load {before} before, {machine.load()} after; one thread, CPU time, median of {TURNS} turns"
    return found, about


def multibody_peers() -> Made:
    """Errors of positions and CPU time of all methods and settings, the first table of the page, and its picture."""
    return _rows(False, _draw)


def multibody_peers_iftomm() -> Made:
    """The problems A01 to A04 of the IFToMM's library beside OpenSim."""
    return _rows(True)


def _rows(iftomm: bool, draw: Callable[[], Sequence[Path]] = nothing) -> Made:
    found, about = measured(iftomm)
    rows = [
        [name, r.method, r.setting, f"{1e3 * r.cpu:.3g}", r.judged.errors[0]]
        for name, (_, result) in found.items()
        for r in result.rows
    ]
    said = {f"{name}: {remark}": None for name, (_, result) in found.items() for remark in result.remarks}
    sure = ", ".join(f"{name} {case.uncertainty:.0e}" for name, (case, _) in found.items())
    notes = (*said, f"distance of the references at relative tolerances of 1e-12 and 1e-13: {sure}", about)
    head = ["mechanism", "method", "setting", "ms/s", "error, m"]
    return table(head, rows, ".1e", notes=(*notes, machine.versions()), draw=draw)


def _cost(rows: Sequence[Row], level: float) -> float | None:
    """The cheapest method at an error in CPU seconds per second; None where none reaches it."""
    methods = {r.method for r in rows}
    costs = (cost_at(level, [r for r in rows if r.method == m], 0) for m in methods)
    return min((c.cpu for c in costs if c is not None), default=None)


def multibody_peers_equal() -> Made:
    """Costs at equal errors in ms of CPU per second, and how many times those of phfmu they are."""
    found, _ = measured()
    rows: list[list[Any]] = []
    for name, (_, result) in found.items():
        by_column = {c: [r for r in result.rows if r.method.startswith(starts)] for c, starts in COLUMNS.items()}
        for level in LEVELS:
            own, *others = (_cost(of, level) if of else None for of in by_column.values())
            cells = [
                "" if not of else "not reached" if cost is None else f"{1e3 * cost:.3g}{_times(cost, own)}"
                for of, cost in zip(list(by_column.values())[1:], others, strict=True)
            ]
            rows.append([name, f"{level:.0e}", "not reached" if own is None else f"{1e3 * own:.3g}", *cells])
    return table(["mechanism", "error, m", *COLUMNS], rows)


def _times(cost: float, own: float | None) -> str:
    return "" if own is None else f" ({cost / own:.2g})"


def _draw() -> Sequence[Path]:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    found, about = measured()
    shown = [(name, case, result) for name, (case, result) in found.items() if len(result.methods()) > 2]
    lines = -(-len(shown) // 3)
    figure, axes = plt.subplots(lines, 3, figsize=(12.0, 3.9 * lines), layout="constrained", squeeze=False)
    for ax in axes.flat[len(shown) :]:
        ax.set_visible(False)
    for ax, (name, case, result) in zip(axes.flat, shown, strict=False):
        draw_lines(ax, case, result)
        ax.set(title=name, xlabel=f"error of positions in m at t = {case.stop:g} s", ylabel="CPU time in ms per second")
        ax.legend(fontsize=7, frameon=False)
    figure.supxlabel(f"{about}\n{machine.versions()}", fontsize=7, color="0.4")
    path = DOCS / "results" / "img" / "multibody.png"
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return (path,)
