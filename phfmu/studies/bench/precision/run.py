"""One comparison from a scene to files: candidates chosen, measured, written."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from phfmu.studies.bench import machine
from phfmu.studies.bench.precision import exudyn_particles, mujoco_chain, own, peers, report, sundae
from phfmu.studies.bench.precision.candidate import Candidate
from phfmu.studies.bench.precision.problem import InitialValueProblem
from phfmu.studies.bench.precision.work_precision import WorkPrecisionTable, measure
from phfmu.studies.tables import write_csv

TOLERANCES = (1e-3, 1e-4, 1e-6, 1e-8, 1e-10)
#: default steps in multiples of the scene's step
MULTIPLES = (8.0, 4.0, 2.0, 1.0, 0.5)
PEERS = ("scipy", "casadi", "sundae", "mujoco", "exudyn")


@dataclass(frozen=True)
class ComparisonSettings:
    """A choice of what is compared: schemes NAME:ORDER, engines, steps [s], relative tolerances and names of peers."""

    schemes: tuple[str, ...] = ()
    engines: tuple[str, ...] = ("native",)
    steps: tuple[float, ...] = ()
    tolerances: tuple[float, ...] = TOLERANCES
    peers: tuple[str, ...] = PEERS
    repeat: int = 5
    errors: tuple[float, ...] = ()


def candidates(
    problem: InitialValueProblem, choice: ComparisonSettings, functions: peers.ProblemFunctions
) -> Iterator[Candidate]:
    """Own schemes first, then the peers that are there."""
    schemes = choice.schemes or own.default_schemes(problem)
    steps = choice.steps or [m * problem.step for m in MULTIPLES]
    yield from own.candidates(problem, schemes, choice.engines, steps)
    if "scipy" in choice.peers:
        yield from peers.scipy_candidates(problem, choice.tolerances, functions)
    if "casadi" in choice.peers:
        yield from peers.casadi_candidates(problem, choice.tolerances, functions)
    if "sundae" in choice.peers:
        yield from sundae.candidates(problem, choice.tolerances)
    links = re.fullmatch(r"chain_(\d+)", problem.name)
    if "mujoco" in choice.peers and links:
        yield from mujoco_chain.candidates(problem, int(links[1]))
    if "exudyn" in choice.peers:
        yield from exudyn_particles.candidates(problem)


def default_errors(table: WorkPrecisionTable) -> tuple[float, ...]:
    """Powers of ten that an own scheme reaches at the last time."""
    reached = [r.judged.errors[-1] for r in table.rows if r.own]
    return tuple(10.0**e for e in (-3, -4, -6, -8, -10) if reached and min(reached) <= 10.0**e)


@dataclass(frozen=True)
class WorkPrecisionReport:
    """A measured table, lines about it (machine, versions, settings) and the ratios at equal errors."""

    problem: InitialValueProblem
    table: WorkPrecisionTable
    about: tuple[str, ...]
    ratios: tuple[str, ...]
    caption: str


def compare(
    problem: InitialValueProblem, choice: ComparisonSettings, progress: Callable[[str], None] = lambda _: None
) -> WorkPrecisionReport:
    """Measure all candidates of a choice; the reference is solved first unless there is one."""
    before, functions = machine.load(), peers.ProblemFunctions(problem)
    if not len(problem.reference):
        progress("reference")
        peers.solve_reference(problem, functions)
    table = measure(problem, candidates(problem, choice, functions), choice.repeat, progress)
    known = f", uncertain by {problem.uncertainty:.1g}" if problem.uncertainty == problem.uncertainty else ""
    caption = f"{machine.machine_line(before)}; one thread, process CPU time"
    states, times = ", ".join(problem.judged) or "all states", ", ".join(f"{t:g}" for t in problem.times)
    about = (
        f"{problem.name}: errors of {states} at {times} s; timed over {problem.stop:g} s, median of {choice.repeat}",
        f"reference: {problem.reference_name}{known}",
        caption,
        machine.versions(),
    )
    ratios = report.ratios_text(problem, table, choice.errors or default_errors(table))
    return WorkPrecisionReport(problem, table, about, tuple(ratios), caption)


def write(found: WorkPrecisionReport, folder: Path) -> list[str]:
    """`<name>.csv`, `.png` (matplotlib) and `.html` (plotly) in `folder`; returns the printed lines."""
    problem, table = found.problem, found.table
    folder.mkdir(parents=True, exist_ok=True)
    written = [f"{problem.name}.csv"]
    rows = map(report.cells, table.rows)
    write_csv(folder / written[0], [*found.about, *found.ratios, *table.remarks], report.columns(problem), rows)
    if find_spec("matplotlib") is not None:
        written.append(f"{problem.name}.png")
        report.write_png(folder / written[-1], problem, table, f"{found.caption}\n{machine.versions()}")
    if find_spec("plotly") is not None:
        written.append(f"{problem.name}.html")
        report.write_html(folder / written[-1], problem, table, found.caption)
    last = f"written: {', '.join(written)} in {folder}"
    return [*found.about, "", report.rows_text(problem, table), "", *found.ratios, *table.remarks, last]


def known_peers(names: Sequence[str]) -> tuple[str, ...]:
    """Peers by name; `all` and `none` are names too."""
    if list(names) == ["all"]:
        return PEERS
    if list(names) == ["none"]:
        return ()
    for name in names:
        if name not in PEERS:
            raise ValueError(f"--peers {name}: choose from all, none, {', '.join(PEERS)}")
    return tuple(names)
