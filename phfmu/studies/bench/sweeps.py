"""Cost of a sweep beside its steps, with one thread and with as many as cores, and where it ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from time import perf_counter, thread_time
from typing import TYPE_CHECKING

import numpy as np

from phfmu.studies.bench.machine import cpu_seconds, machine_line
from phfmu.studies.tables import markdown_table

if TYPE_CHECKING:
    from phfmu.discretise.model import Model
    from phfmu.sweeps.design import Design

SCENE, VARIED = "four_particle", "k13"
TURNS = 3  # that the medians are of
ALONE = 256  # runs that tell what steps take
FEW, MANY = ("max(v[1])",), ("max(q)", "min(q)", "rms(v)", "peak(v)")
AT_ENDS = ("max(lambda_end[1])",)


@dataclass(frozen=True)
class SweepCase:
    """A sweep of so many runs of `stop` s, with these measures."""

    runs: int
    stop: float
    measures: tuple[str, ...]


CASES = (
    SweepCase(10_000, 1.0, FEW), SweepCase(10_000, 0.01, FEW), SweepCase(100_000, 0.01, FEW), SweepCase(2_000, 1.0, MANY),
    SweepCase(2_000, 1.0, AT_ENDS),
)  # fmt: skip


@dataclass(frozen=True)
class SweepCost:
    """Time of a run in us: of its steps alone, in a sweep by one thread and by `jobs`; what the sweep takes once in ms.

    CPU time of one thread, but wall time of `jobs`.
    steps: of a run;  values: measures of a run, one for each element;  share: of what `jobs` cores could do in steps alone;
    size: bytes of a run in the table;  same: whether `jobs` gave the bits of one
    """

    steps: int
    values: int
    alone: float
    one: float
    every: float
    once: float
    jobs: int
    share: float
    size: float
    same: bool


class _Alone:
    """Steps of some of the runs in calls of the engine, without what a call costs."""

    def __init__(self, model: Model, runs: Design, h: float, n: int):
        from phfmu.engine.native.native import NativeInstance

        declared = model.declaration.parameters
        place = [p.name for p in declared].index(VARIED)
        self._instance, self._first = NativeInstance(model, kernels="compiled"), sum(p.n for p in declared[:place])
        self._values, self._h, self._n = runs.rows[:: max(1, len(runs.rows) // ALONE), 0], h, n

    def time(self) -> float:
        """CPU time of a run in us."""
        spent, parameters = 0.0, self._instance.parameters.copy()
        for value in self._values:
            self._instance.reset()
            parameters[self._first] = value
            self._instance.set_parameters(parameters)
            times = [thread_time()]
            for n in (0, self._n):
                self._instance.run(0.0, self._h, n)
                times.append(thread_time())
            spent += times[2] - 2 * times[1] + times[0]
        return 1e6 * spent / len(self._values)


def measure(case: SweepCase, jobs: int) -> SweepCost:
    from phfmu.discretise.model import build_model
    from phfmu.runs.options import Options
    from phfmu.sweeps.design import grid
    from phfmu.sweeps.runs import sweep
    from phfmu.target import scene

    here = scene(SCENE)
    start = float(next(p.start[0] for p in here.declaration().parameters if p.name == VARIED))
    options = Options(stop=case.stop, step=here.step)
    runs = grid({VARIED: start * np.linspace(1.0, 1.2, case.runs)})
    take = partial(sweep, here, measures=case.measures, options=options, lanes=False)
    take(grid({VARIED: [start]}))  # what is compiled once
    model = build_model(here.declaration())
    engine = _Alone(model, runs, here.step, round(case.stop / here.step))
    once = _seconds(lambda: take(grid({VARIED: [start]}), jobs=1))
    times: dict[int, list[float]] = {1: [], jobs: []}
    tables, steps = {}, []
    for _ in range(TURNS):
        steps.append(engine.time())
        for n, spent in times.items():
            clock = thread_time if n == 1 else perf_counter
            before = clock()
            tables[n] = take(runs, jobs=n)
            spent.append(clock() - before)
    alone = median(steps)
    one, every = (1e6 * (median(times[n]) - once) / case.runs for n in (1, jobs))
    found = tables[jobs]
    return SweepCost(
        int(found["steps"][0].as_py()), found.num_columns - len(runs.names) - 3, alone, one, every, 1e3 * once, jobs,
        alone / (jobs * every), found.nbytes / case.runs, found.equals(tables[1]),
    )  # fmt: skip


#: runs that are stepped side by side: scene, what varies, measure, order, s
TOGETHER = (
    ("oscillator", "mass1.k", "max(mass1.q)", 2, 1.0), ("oscillator", "mass1.k", "max(mass1.q)", 4, 1.0),
    ("oscillator", "mass1.k", "max(mass1.q)", 6, 1.0), ("two_machine", "line.R", "max(line.flux[1])", 2, 0.01),
    ("dc_motor", "R", "max(flux)", 2, 0.1), ("four_particle", "k13", "max(v[1])", 2, 3.0),
    ("chain", "m[1]", "max(v[1])", 2, 1.0), ("rope_bridge", "m[1]", "max(v[1])", 2, 1.0),
    ("four_particle", "k13", "max(v[1])", 6, 3.0),
)  # fmt: skip
SIDE_BY_SIDE = 160  # runs of a turn
MORE_TURNS = 5


@dataclass(frozen=True)
class LaneGain:
    """CPU time of a step of a sweep by one thread in us, each run by itself and several side by side, both with compiled kernels.

    gain: median over turns of both;  inside: part of the steps that were taken side by side;  same: whether bits are the same
    """

    alone: float
    together: float
    gain: float
    inside: float
    same: bool


def gain(name: str, varied: str, measured: str, order: int, stop: float) -> LaneGain:
    from phfmu.engine.native.native import NativeInstance
    from phfmu.runs.options import Options
    from phfmu.schemes.named import named_scheme
    from phfmu.sweeps.lanes import LaneSolver
    from phfmu.sweeps.native_runs import NativeRuns
    from phfmu.sweeps.recipe import Recipe
    from phfmu.target import scene

    here = scene(name)
    declaration = here.declaration()
    start = next(
        float(v) for p in declaration.parameters for n, v in zip(p.names(), p.start, strict=True) if n == varied
    )
    options = Options(stop=stop, step=here.step)
    task = Recipe(here, (varied,), (measured,), options, named_scheme(declaration, order=order), "native").task()
    compiled = NativeInstance(task.model, kernels="compiled")
    schur = task.model.step.schur
    made = None if schur is None else LaneSolver(schur)  # is found then
    rows = start * np.linspace(1.0, 1.2, SIDE_BY_SIDE)[:, None]
    both = NativeRuns(task, lanes=False), NativeRuns(task)
    times, found = tuple[list[float], list[float]](([], [])), [runs.take(rows) for runs in both]
    for _ in range(MORE_TURNS):
        for i, (runs, spent) in enumerate(zip(both, times, strict=True)):
            before = thread_time()
            found[i] = runs.take(rows)
            spent.append(thread_time() - before)
    del compiled, made
    a, b = found
    n = 1e-6 * a.steps.sum()
    return LaneGain(
        median(times[0]) / n, median(times[1]) / n, median(x / y for x, y in zip(*times, strict=True)),
        float(b.inside / b.steps.sum()),
        all(getattr(a, part).tobytes() == getattr(b, part).tobytes() for part in ("values", "steps", "ledger")),
    )  # fmt: skip


def gains(progress: Callable[[str], None] = lambda _: None) -> str:
    """The gains of runs side by side in Markdown."""
    head = ["scene", "order", "alone us/step", "side by side us/step", "gain", "steps side by side", "same bits"]
    rows = []
    for case in TOGETHER:
        progress(f"{case[0]}, order {case[3]}, side by side")
        g = gain(*case)
        numbers = f"{g.alone:.2f}", f"{g.together:.2f}", f"{g.gain:.1f}", f"{100 * g.inside:.1f} %"
        rows.append([case[0], case[3], *numbers, "yes" if g.same else "no"])
    return markdown_table(head, rows)


def _seconds(take: Callable[[], object]) -> float:
    """Median of some turns."""
    return median(cpu_seconds(take) for _ in range(TURNS))


def table(cases: Sequence[SweepCase] = CASES, progress: Callable[[str], None] = lambda _: None) -> str:
    """The costs of all cases in Markdown, and the machine."""
    from phfmu.processors import processors

    jobs = processors()
    head = [
        "runs", "steps", "values", "steps alone us", "1 thread us", "own us", f"{jobs} threads us", "share of the cores",
        "once ms", "bytes a run", "same bits",
    ]  # fmt: skip
    rows = []
    for case in cases:
        progress(f"{case.runs} runs of {case.stop} s, {', '.join(case.measures)}")
        c = measure(case, jobs)
        times = (f"{x:.1f}" for x in (c.alone, c.one, c.one - c.alone, c.every))
        rest = f"{c.share:.2f}", f"{c.once:.0f}", f"{c.size:.0f}", "yes" if c.same else "no"
        rows.append([case.runs, c.steps, c.values, *times, *rest])
    return f"{markdown_table(head, rows)}\n\n{machine_line()}"


PAGE = """# Sweeps

Runs of `four_particle` that differ in one stiffness, time of a run: of its steps alone, in calls of the engine; in a sweep by
one thread, whose `own` part is what a run costs beside its steps (once: values set, start checked, a row of the table; in each
step: measures, ledger judged), both in CPU time; and by all cores, on the wall. Each run is stepped by itself here
(`--no-lanes`). `share of the cores`: steps alone over what the cores had time for. `once`: what a sweep costs that does not grow
with its runs, with code that was compiled before.

Where it ends: runs of one step cost little but the own part, many measures cost theirs in every step, and a measure of a value
at an instant takes a solve there in every step (last row). Memory grows by the row of each run.

    phfmu bench sweep -o docs/results/sweep.md

"""


#: after the first table
LANES = """

## Runs side by side

Steps of several runs at a time, each number a vector with one of each run, against steps of each by itself with compiled
kernels: CPU time of a step by one thread, with all that a sweep does in it; gain: the median of turns, each of them one after the
other in one process. Newton's method has interpreted kernels here; a
[Schur stepper](../understand/glossary.md#schur-stepper) is compiled once more, when it is found or the runs earn the compiler's
time. For one run it has the nodes of a step in a vector already, two numbers at order 2 and four at order 6: vectors of this
processor hold four, so that at order 6 several runs gain nothing, and steps are taken run by run.

"""


def page(progress: Callable[[str], None] = lambda _: None) -> str:
    return PAGE + table(progress=progress) + LANES + gains(progress) + f"\n\n{machine_line()}\n"
