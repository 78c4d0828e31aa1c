"""A work-precision table as text, CSV, PNG and HTML."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from phfmu.studies.bench.precision.problem import InitialValueProblem, WorkPrecisionProblem
from phfmu.studies.bench.precision.work_precision import WorkPrecisionRow, WorkPrecisionTable, costs_at
from phfmu.studies.figures import pyplot, save
from phfmu.studies.tables import aligned_table

FLOOR = 1e-17  # zero on a logarithmic axis


def columns(problem: InitialValueProblem) -> list[str]:
    return [
        "method", "setting", "cpu_ms_per_s", "spread", *(f"error_{t:g}s" for t in problem.times), "energy_error_J", "drift",
        "ledger_J", "steps", "iterations",
    ]  # fmt: skip


def cells(row: WorkPrecisionRow) -> list[Any]:
    judged = row.judged
    return [
        row.method, row.setting, 1e3 * row.cpu, row.spread, *judged.errors, judged.energy, judged.drift, row.ledger,
        row.steps, row.iterations,
    ]  # fmt: skip


def _text(value: Any) -> str:
    return "" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def rows_text(problem: InitialValueProblem, table: WorkPrecisionTable) -> str:
    """The table in aligned columns."""
    return aligned_table(columns(problem), ([_text(c) for c in cells(r)] for r in table.rows), 2)


def ratios_text(problem: InitialValueProblem, table: WorkPrecisionTable, errors: Sequence[float]) -> list[str]:
    """Per error level: the cheapest own method, and what each peer costs relative to it (at the last time)."""
    which = len(problem.times) - 1
    out = []
    for error in errors:
        found = costs_at(table, error, which)
        own, peers = [c for c in found if c.own], [c for c in found if not c.own]
        if not own:
            out.append(f"ratio at error {error:g}: no scheme of this package reaches it")
            continue
        best = own[0]
        parts = [f"{c.method} {'<= ' if c.bound else ''}{c.cpu / best.cpu:.3g}" for c in peers]
        absent = [m for m in table.methods() if not any(c.method == m for c in found)]
        parts += [f"{m} not reached" for m in absent]
        out.append(
            f"ratio at error {error:g}: {best.method} {'<= ' if best.bound else ''}{1e3 * best.cpu:.3g} ms/s = 1; "
            + (", ".join(parts) or "no peers")
        )
    return out


def _lines(
    problem: WorkPrecisionProblem, table: WorkPrecisionTable
) -> list[tuple[str, bool, list[tuple[float, float, str]]]]:
    which, out = len(problem.times) - 1, []
    for method in table.methods():
        rows = [r for r in table.rows if r.method == method]
        points = [(max(r.judged.errors[which], FLOOR), 1e3 * r.cpu, r.setting) for r in rows]
        out.append((method, rows[0].own, points))
    return out


def draw_lines(ax: Any, problem: WorkPrecisionProblem, table: WorkPrecisionTable) -> None:
    """CPU time over error in double logarithmic axes, a line per method, errors falling to the right."""
    import matplotlib.pyplot as plt

    own_colours, marks = ["#1f6fb4", "#d1711b", "#5b8c3a", "#8a4fb0", "#b03a48"], "osD^vP*X"
    greys = plt.get_cmap("Greys")
    lines = _lines(problem, table)
    own = [m for m, mine, _ in lines if mine]
    peers = [m for m, mine, _ in lines if not mine]
    for method, mine, points in lines:
        number = (own if mine else peers).index(method)
        colour = own_colours[number % len(own_colours)] if mine else greys(0.45 + 0.5 * number / max(len(peers), 1))
        ax.loglog(
            [p[0] for p in points], [p[1] for p in points], marker=marks[number % len(marks)], color=colour, label=method,
            lw=2.0 if mine else 1.0, ls="-" if mine else "--", ms=5.5, mfc=colour if mine else "white",
        )  # fmt: skip
    ax.invert_xaxis()
    ax.grid(which="major", color="0.9")
    ax.spines[["top", "right"]].set_visible(False)


def write_png(path: Path, problem: InitialValueProblem, table: WorkPrecisionTable, caption: str) -> None:
    """CPU time over error, one line per method; own schemes in full colour with filled marks."""
    plt = pyplot()

    figure, ax = plt.subplots(figsize=(8.5, 5.4), layout="constrained")
    draw_lines(ax, problem, table)
    which = f"relative error of {', '.join(problem.judged) or 'the states'} at t = {problem.times[-1]:g} s"
    ax.set(xlabel=which, ylabel="CPU time in ms per simulated second", title=problem.name)
    ax.legend(fontsize=8, frameon=False, bbox_to_anchor=(1.01, 1.0), loc="upper left")
    figure.supxlabel(caption, fontsize=7, color="0.4")
    save(figure, path)


def write_html(path: Path, problem: InitialValueProblem, table: WorkPrecisionTable, caption: str) -> None:
    """The same picture for a browser, settings at the marks; needs plotly."""
    go: Any = import_module("plotly.graph_objects")
    figure = go.Figure()
    for method, mine, points in _lines(problem, table):
        figure.add_scatter(
            x=[p[0] for p in points], y=[p[1] for p in points], text=[p[2] for p in points], name=method,
            mode="lines+markers", line={"dash": "solid" if mine else "dash"},
        )  # fmt: skip
    figure.update_xaxes(type="log", autorange="reversed", title=f"relative error at t = {problem.times[-1]:g} s")
    figure.update_yaxes(type="log", title="CPU time in ms per simulated second")
    figure.update_layout(title=f"{problem.name}<br><sub>{caption}</sub>")
    figure.write_html(path, include_plotlyjs="cdn")
