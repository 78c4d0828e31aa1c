"""Tables and picture of docs/results/grid-peers.md: machines at a grid and nine buses beside DPsim."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pages import PageBlock, table
from peers import cheapest, draw_panels, measured_in_turns, remarks

from phfmu.studies.bench import machine
from phfmu.studies.bench.power.cases import CASES, GridCase
from phfmu.studies.bench.power.dpsim import FOURTH
from phfmu.studies.bench.precision.work_precision import WorkPrecisionRow, WorkPrecisionTable

TURNS = 3  # of which the median counts
LEVELS = (1e-2, 1e-3, 1e-4)
VERSIONS = ("phfmu", "numpy", "scipy", "dpsim")


@cache
def measured() -> tuple[dict[str, tuple[GridCase, WorkPrecisionTable]], str]:
    """All circuits, each with its methods in turns; the machine with its load."""
    return measured_in_turns(CASES, lambda case: case.candidates(), TURNS)


def per_step(case: GridCase, row: WorkPrecisionRow) -> float:
    """CPU time of a step in us."""
    assert row.steps
    return 1e6 * row.cpu * case.stop / row.steps


def grid_peers() -> PageBlock:
    """Errors, CPU time per second and per step of both tools at all steps, and the picture of the page."""
    found, about = measured()
    rows = [
        [name, r.method, r.setting, f"{1e3 * r.cpu:.3g}", f"{per_step(case, r):.2f}", r.judged.errors[0]]
        for name, (case, result) in found.items()
        for r in result.rows
    ]
    head = ["circuit", "method", "step", "ms/s", "us/step", "error"]
    return table(head, rows, ".1e", notes=(*remarks(found), about, machine.versions(VERSIONS)), draw=_draw)


def grid_peers_equal() -> PageBlock:
    """The cheapest way to an error on the circuit of one machine: ms of CPU per second of both tools, and their ratio."""
    found, _ = measured()
    rows: list[list[Any]] = []
    for name, (_, result) in found.items():
        if not name.startswith("smib"):
            continue
        for level in LEVELS:
            own, peer = (cheapest([r for r in result.rows if r.own == mine], level) for mine in (True, False))
            ratio = f"{peer / own:.2g}" if own and peer else ""
            rows.append(
                [name, f"{level:.0e}", *("not reached" if c is None else f"{1e3 * c:.3g}" for c in (own, peer)), ratio]
            )
    return table(["circuit", "error", "phfmu, ms/s", "DPsim, ms/s", "DPsim / phfmu"], rows)


def grid_peers_steps() -> PageBlock:
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
    found, about = measured()
    shown = [
        (
            name,
            case,
            WorkPrecisionTable([r for r in result.rows if r.judged.errors[0] < 10], result.remarks),
            f"error of the {case.judged[0]}, relative",
        )
        for name, (case, result) in found.items()
    ]
    return draw_panels("grid_peers.png", shown, 2, (5.25, 4.0), f"{about}\n{machine.versions(VERSIONS)}")
