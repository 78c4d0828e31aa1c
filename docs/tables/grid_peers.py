"""Tables and picture of docs/results/grid-peers.md: machines at a grid and nine buses beside DPsim."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pages import DOCS, Made, table

from phfmu.studies.bench import machine
from phfmu.studies.bench.power.cases import CASES, GridCase
from phfmu.studies.bench.power.dpsim import FOURTH
from phfmu.studies.bench.report import draw_lines
from phfmu.studies.bench.work_precision import Row, Table, cost_at, measure

TURNS = 3  # of which the median counts
LEVELS = (1e-2, 1e-3, 1e-4)
VERSIONS = ("phfmu", "numpy", "scipy", "dpsim")


@cache
def measured() -> tuple[dict[str, tuple[GridCase, Table]], str]:
    """All circuits, each with its methods in turns; the machine with its load."""
    before, found = machine.load(), {}
    for name, made in CASES.items():
        print(f"{name}: reference", file=sys.stderr, flush=True)
        case = made()
        result = measure(case, case.candidates(), TURNS, lambda said: print(said, file=sys.stderr, flush=True))
        for said in result.remarks:
            print(f"{name}: {said}", file=sys.stderr, flush=True)
        found[name] = (case, result)
    about = f"{machine.processor()}; load {before} before, {machine.load()} after; one thread, CPU time, median of {TURNS} turns"
    return found, about


def per_step(case: GridCase, row: Row) -> float:
    """CPU time of a step in us."""
    assert row.steps
    return 1e6 * row.cpu * case.stop / row.steps


def grid_peers() -> Made:
    """Errors, CPU time per second and per step of both tools at all steps, and the picture of the page."""
    found, about = measured()
    rows = [
        [name, r.method, r.setting, f"{1e3 * r.cpu:.3g}", f"{per_step(case, r):.2f}", r.judged.errors[0]]
        for name, (case, result) in found.items()
        for r in result.rows
    ]
    said = {f"{name}: {remark}": None for name, (_, result) in found.items() for remark in result.remarks}
    head = ["circuit", "method", "step", "ms/s", "us/step", "error"]
    return table(head, rows, ".1e", notes=(*said, about, machine.versions(VERSIONS)), draw=_draw)


def grid_peers_equal() -> Made:
    """The cheapest way to an error on the circuit of one machine: ms of CPU per second of both tools, and their ratio."""
    found, _ = measured()
    rows: list[list[Any]] = []
    for name, (_, result) in found.items():
        if not name.startswith("smib"):
            continue
        for level in LEVELS:
            own, peer = (_cheapest(result, level, mine) for mine in (True, False))
            ratio = f"{peer / own:.2g}" if own and peer else ""
            rows.append(
                [name, f"{level:.0e}", *("not reached" if c is None else f"{1e3 * c:.3g}" for c in (own, peer)), ratio]
            )
    return table(["circuit", "error", "phfmu, ms/s", "DPsim, ms/s", "DPsim / phfmu"], rows)


def _cheapest(result: Table, level: float, own: bool) -> float | None:
    costs = (cost_at(level, [r for r in result.rows if r.method == m], 0) for m in result.methods())
    return min((c.cpu for c in costs if c is not None and c.own == own), default=None)


def grid_peers_steps() -> Made:
    """CPU time per step of 50 us, and how many of them one with DPsim's machines of order 4 takes."""
    found, _ = measured()
    rows: list[list[Any]] = []
    for name, (case, result) in found.items():
        at = {r.method: per_step(case, r) for r in result.rows if r.setting == "h=50 us"}
        peer = at.get(f"DPsim {FOURTH}")
        for method, us in at.items():
            rows.append([name, method, f"{us:.2f}", f"{peer / us:.2f}" if peer else ""])
    return table(["circuit", "method", "us/step", "DPsim 4OrderVBR / this"], rows)


def _draw() -> Sequence[Path]:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    found, about = measured()
    figure, axes = plt.subplots(2, 2, figsize=(10.5, 8.0), layout="constrained")
    for ax, (name, (case, result)) in zip(axes.flat, found.items(), strict=True):
        shown = Table([r for r in result.rows if r.judged.errors[0] < 10], result.remarks)
        draw_lines(ax, case, shown)
        ax.set(title=name, xlabel=f"error of the {case.judged[0]}, relative", ylabel="CPU time in ms per second")
        ax.legend(fontsize=7, frameon=False)
    figure.supxlabel(f"{about}\n{machine.versions(VERSIONS)}", fontsize=7, color="0.4")
    path = DOCS / "results" / "img" / "grid_peers.png"
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return (path,)
