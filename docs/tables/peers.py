"""Pages beside other tools: cases that are measured in turns, and panels of CPU time over error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from pages import DOCS

from phfmu.studies.bench import machine
from phfmu.studies.bench.precision.candidate import Candidate
from phfmu.studies.bench.precision.problem import WorkPrecisionProblem
from phfmu.studies.bench.precision.report import draw_lines
from phfmu.studies.bench.precision.work_precision import WorkPrecisionRow, WorkPrecisionTable, cost_at, measure
from phfmu.studies.figures import pyplot, save

Measured = TypeVar("Measured", bound=WorkPrecisionProblem)


def measured_in_turns(
    cases: Mapping[str, Callable[[], Measured]], candidates: Callable[[Measured], Iterable[Candidate]], turns: int
) -> tuple[dict[str, tuple[Measured, WorkPrecisionTable]], str]:
    """All cases, each with its methods in turns; the machine with its load."""
    before, found = machine.load(), dict[str, tuple[Measured, WorkPrecisionTable]]()
    for name, made in cases.items():
        print(f"{name}: reference", file=sys.stderr, flush=True)
        case = made()
        result = measure(case, [*candidates(case)], turns, lambda said: print(said, file=sys.stderr, flush=True))
        for said in result.remarks:
            print(f"{name}: {said}", file=sys.stderr, flush=True)
        found[name] = (case, result)
    about = f"{machine.machine_line(before)}; one thread, CPU time, median of {turns} turns"
    return found, about


def remarks(found: Mapping[str, tuple[WorkPrecisionProblem, WorkPrecisionTable]]) -> list[str]:
    """Remarks on the cases, each line once."""
    return list(dict.fromkeys(f"{name}: {remark}" for name, (_, result) in found.items() for remark in result.remarks))


def cheapest(rows: Sequence[WorkPrecisionRow], level: float) -> float | None:
    """CPU seconds per second of the cheapest method at an error; None where none reaches it."""
    methods = {r.method for r in rows}
    costs = (cost_at(level, [r for r in rows if r.method == m], 0) for m in methods)
    return min((c.cpu for c in costs if c is not None), default=None)


def draw_panels(
    picture: str,
    panels: Sequence[tuple[str, WorkPrecisionProblem, WorkPrecisionTable, str]],
    columns: int,
    size: tuple[float, float],
    foot: str,
) -> Sequence[Path]:
    """docs/results/img/PICTURE: a panel for each (title, case, rows, what the error is of), each of a size in inch."""
    plt = pyplot()

    lines = -(-len(panels) // columns)
    figure, axes = plt.subplots(
        lines, columns, figsize=(columns * size[0], lines * size[1]), layout="constrained", squeeze=False
    )
    for ax in axes.flat[len(panels) :]:
        ax.set_visible(False)
    for ax, (title, case, rows, error) in zip(axes.flat, panels, strict=False):
        draw_lines(ax, case, rows)
        ax.set(title=title, xlabel=error, ylabel="CPU time in ms per second")
        ax.legend(fontsize=7, frameon=False)
    figure.supxlabel(foot, fontsize=7, color="0.4")
    path = DOCS / "results" / "img" / picture
    save(figure, path, 130)
    return (path,)
