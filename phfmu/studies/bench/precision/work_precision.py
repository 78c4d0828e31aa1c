"""Work and precision of candidates in one run: errors, CPU time, steps, ledger; costs at equal errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np

from phfmu.outcome.status import StepFailure
from phfmu.studies.bench.precision.candidate import Candidate, NotAvailable
from phfmu.studies.bench.precision.problem import SolutionErrors, WorkPrecisionProblem

#: CPU seconds after which a row is not timed again
LONG = 3.0


@dataclass(frozen=True)
class WorkPrecisionRow:
    """One candidate measured.  cpu: process CPU seconds per simulated second, median of the repeats (fewer
    for rows that take longer than LONG); spread: (max-min)/median;  ledger: worst residual of a step [J]."""

    method: str
    setting: str
    own: bool
    cpu: float
    spread: float
    judged: SolutionErrors
    steps: int | None
    iterations: int | None
    ledger: float | None


@dataclass
class WorkPrecisionTable:
    """Measured rows, and remarks on what is missing."""

    rows: list[WorkPrecisionRow]
    remarks: list[str]

    def methods(self) -> list[str]:
        return list(dict.fromkeys(r.method for r in self.rows))


def measure(
    problem: WorkPrecisionProblem,
    candidates: Iterable[Candidate],
    repeat: int,
    progress: Callable[[str], None] = lambda _: None,
) -> WorkPrecisionTable:
    """Accuracy first, then `repeat` timed runs to the stop time, taken in turns so that load on the machine hits all alike."""
    table = WorkPrecisionTable([], [])
    ready = []
    for c in candidates:
        progress(f"{c.method} {c.setting}")
        try:
            solve = c.prepare()
            run = solve(list(problem.grid), watch=True)
        except NotAvailable as missing:
            table.remarks.append(f"{c.method}: {missing}")
            continue
        except (StepFailure, RuntimeError, ArithmeticError) as failure:
            table.remarks.append(f"{c.method} {c.setting}: {str(failure).splitlines()[0][:160]}")
            continue
        if not np.isfinite(run.x).all():
            table.remarks.append(f"{c.method} {c.setting}: result is not finite")
            continue
        ready.append((c, solve, run, problem.judge(run.x)))
    spent: list[list[float]] = [[] for _ in ready]
    for turn in range(repeat):
        progress(f"timing {turn + 1} of {repeat}")
        for (_, solve, _, _), times in zip(ready, spent, strict=True):
            if sum(times) * problem.stop > LONG:
                continue
            start = process_time()
            run = solve([problem.stop])
            spent_here = process_time() - start
            times.append((spent_here if run.cpu is None else run.cpu) / problem.stop)
    for (c, _, run, judged), times in zip(ready, spent, strict=True):
        cpu = float(np.median(times))
        spread = (max(times) - min(times)) / cpu if cpu else 0.0
        table.rows.append(
            WorkPrecisionRow(c.method, c.setting, c.own, cpu, spread, judged, run.steps, run.iterations, run.ledger)
        )
    table.remarks = list(dict.fromkeys(table.remarks))
    return table


def front(rows: Sequence[WorkPrecisionRow], which: int) -> list[tuple[float, float]]:
    """(error, cpu) of the rows that no other row beats in both, by falling error; `which`: index of the time."""
    points = sorted((r.judged.errors[which], r.cpu) for r in rows)
    best: list[tuple[float, float]] = []
    for error, cpu in points:
        while best and best[-1][1] <= cpu and best[-1][0] <= error:
            break
        else:
            best.append((error, cpu))
    return best[::-1]


@dataclass(frozen=True)
class CostAtError:
    """CPU seconds per simulated second at an error; `bound`: the coarsest setting was already more accurate."""

    method: str
    own: bool
    cpu: float
    bound: bool


def cost_at(error: float, rows: Sequence[WorkPrecisionRow], which: int) -> CostAtError | None:
    """Cost of one method at `error`, between its rows on the double logarithmic line; None if no row is that accurate."""
    line = front(rows, which)
    first = rows[0]
    if not line or line[-1][0] > error:
        return None
    if line[0][0] <= error:
        return CostAtError(first.method, first.own, line[0][1], True)
    for (e0, c0), (e1, c1) in zip(line[:-1], line[1:], strict=True):
        if e1 <= error <= e0:
            s = np.log(error / e0) / np.log(max(e1, 1e-300) / e0)
            return CostAtError(first.method, first.own, float(np.exp(np.log(c0) * (1 - s) + np.log(c1) * s)), False)
    return None


def costs_at(table: WorkPrecisionTable, error: float, which: int) -> list[CostAtError]:
    """All methods that reach `error`, the cheapest first."""
    found = [cost_at(error, [r for r in table.rows if r.method == m], which) for m in table.methods()]
    return sorted((c for c in found if c is not None), key=lambda c: c.cpu)
