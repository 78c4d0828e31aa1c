"""Many runs of one composed model, of members apart or of units, in threads or on a cluster, and the table of what came out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu import __version__
from phfmu.files import beside
from phfmu.processors import processors
from phfmu.sweeps.design import Design
from phfmu.sweeps.outcome import RunOutcomes
from phfmu.sweeps.parts import Parts, digest
from phfmu.sweeps.recipe import Recipe, StepperRecipe, Steppers, Target
from phfmu.sweeps.task import Task

if TYPE_CHECKING:
    import pyarrow as pa

    from phfmu.runs.options import Options
    from phfmu.schemes.scheme import Scheme
    from phfmu.sweeps.worker_pool import Scheduler, WorkerPool

#: most runs that are handed to a worker at once, and how many times a worker gets some
BLOCK, TURNS = 512, 8


def sweep(
    target: Target | Steppers | Callable[[], Target],
    design: Design,
    measures: Sequence[str],
    *,
    options: Options | None = None,
    scheme: Scheme | None = None,
    engine: str = "native",
    jobs: int | None = None,
    scheduler: Scheduler | None = None,
    file: Path | None = None,
    resume: bool = False,
    keep: Path | None = None,
    lanes: bool = True,
    progress: Callable[[int], None] | None = None,
    told: Callable[[str], None] | None = None,
) -> pa.Table:
    """Runs of a scene or component, one for each row of the design, told by measures such as `max(gen.w)`.

    Of `Steppers`, of members apart or units, each run has a stepper of its own and is taken by the run loop; `options`, `scheme`
    and `engine` are those of the steppers then.

    One declaration, one compilation; the runs are shared by `jobs` threads (default: one per core), whose number does not
    change a bit of the results.  options: default the scene's (`Options(stop=.., step=..)` for a component);  engine: "native" or
    "python";  file: of the table, .parquet or .csv, with FILE.parts beside it until all is done, from which `resume` goes on;
    scheduler: of a Dask cluster whose workers take the runs; `target` is then a function that gives the scene or component, which
    they call;  keep: folder for the whole result of each run, 000000.parquet and so on, which the run loop takes, not the
    compiled one;  lanes: whether steps of several runs may be taken side by side, which changes no bit of the results;
    progress: called with the number of runs that are done;  told: called with a line that says how many steps were, or why none.
    Table: a column per name and per measure, `steps`, `ledger` (by how much of what is allowed the energy balance of a run
    misses in its worst step: above 1 it is violated), `error` (why a run failed: its measures are null; "" if it did not).
    Errors: KeyError for names that cannot be set, ValueError for measures and options, DeclarationError, CompilerMissing, OSError
    """
    asked = tuple(measures)
    if isinstance(target, Steppers):
        recipe = StepperRecipe(target, design.names, asked, keep)
    else:
        recipe = Recipe(target, design.names, asked, options, scheme, engine, keep, lanes)
    task = recipe.task()
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
    with _worker_pool(
        recipe, task, jobs, scheduler
    ) as pool:  # before the parts: without a cluster those of before stay
        parts = None if file is None else Parts(file, _key(task, recipe, design), resume=resume)
        try:
            outcome = taken(pool, design, parts, progress or (lambda _: None), recipe.at_once)
        except (KeyboardInterrupt, OSError) as stop:
            stop.add_note(
                parts.told(len(design.rows)) if parts is not None else "nothing of it is kept: it has no -o FILE"
            )
            raise
    if told is not None and outcome.inside:
        told(f"{outcome.inside} of {outcome.steps.sum()} steps side by side, {recipe.at_once} runs at a time")
    elif told is not None and outcome.alone:
        told(f"steps are taken run by run: {outcome.alone}")
    table = _table(task, design, outcome)
    if file is not None and parts is not None:
        _write(table, file, parts)
    return table


def _write(table: pa.Table, file: Path, parts: Parts) -> None:
    """Whole or not at all; until it is there the parts stay."""
    from pyarrow import csv, parquet

    written = beside(file)
    try:
        (csv.write_csv if file.suffix == ".csv" else parquet.write_table)(table, written)
        written.replace(file)
    except OSError as error:
        error.add_note(parts.told(len(table)))
        raise
    finally:
        written.unlink(missing_ok=True)
    parts.remove()


def _worker_pool(
    recipe: Any, task: Task, jobs: int | None, scheduler: Scheduler | None
) -> AbstractContextManager[WorkerPool]:
    from phfmu.sweeps.worker_pool import Threads, cluster

    if scheduler is None:
        return nullcontext(Threads(lambda: recipe.runs(task), jobs or processors()))
    if jobs is not None:
        raise ValueError(f"--jobs {jobs} counts threads here; a scheduler has its own workers, leave one of them out")
    if isinstance(recipe, Recipe) and not callable(recipe.target):
        raise ValueError("a scheduler needs a function that gives the scene or component: its workers call it")
    return cluster(recipe.runs, scheduler)


def _key(task: Task, recipe: Recipe | StepperRecipe, design: Design) -> str:
    """A digest of all that outcomes depend on."""
    told = [] if recipe.keep is None else [recipe.keep.absolute()]
    words = (__version__, *told, list(map(str, task.measures)), *task.words)
    return digest("\n".join(map(str, words)), design)


def taken(
    pool: WorkerPool, design: Design, parts: Parts | None, progress: Callable[[int], None], at_once: int = 1
) -> RunOutcomes:
    """All runs, in blocks that the pool takes as it gets ready, of as many as are taken at once, or of some times as many."""
    found: dict[int, RunOutcomes] = dict(parts.kept()) if parts is not None else {}
    known = {run for first, o in found.items() for run in range(first, first + len(o.errors))}
    size = max(1, min(BLOCK, -(-len(design.rows) // (pool.size * TURNS * at_once)) * at_once))
    todo = _blocks(len(design.rows), size, known)
    keep = _BlockStore(found, len(known), parts, progress)
    if not todo:
        return keep.joined()
    with pool.at_work(len(todo)) as submit:
        waiting: dict[Future[RunOutcomes], int] = {}
        for a, b in todo:
            waiting[submit(design.rows[a:b], a)] = a
            _keep_done(waiting, keep, wait_for_one=False)
        while waiting:
            _keep_done(waiting, keep, wait_for_one=True)
    return keep.joined()


def _keep_done(waiting: dict[Future[RunOutcomes], int], keep: _BlockStore, *, wait_for_one: bool) -> None:
    """Blocks that are ready leave `waiting`."""
    done = wait(waiting, return_when=FIRST_COMPLETED).done if wait_for_one else {f for f in waiting if f.done()}
    for future in sorted(done, key=waiting.__getitem__):
        keep(waiting.pop(future), future.result())


def _blocks(n: int, size: int, known: set[int]) -> list[tuple[int, int]]:
    """Ranges of runs that are not known, of at most `size`."""
    edges = [i for i in range(n + 1) if i in (0, n) or (i in known) != (i - 1 in known)]
    spans = [(a, b) for a, b in pairwise(edges) if a not in known]
    return [(i, min(i + size, b)) for a, b in spans for i in range(a, b, size)]


@dataclass
class _BlockStore:
    """Blocks of runs by the number of the first one, on disk too; `done`: how many runs there are in all."""

    found: dict[int, RunOutcomes]
    done: int
    parts: Parts | None
    progress: Callable[[int], None]

    def __call__(self, first: int, outcome: RunOutcomes) -> None:
        self.found[first] = outcome
        self.done += len(outcome.errors)
        if self.parts is not None:
            self.parts.keep(first, outcome)
        self.progress(self.done)

    def joined(self) -> RunOutcomes:
        return RunOutcomes.joined([self.found[a] for a in sorted(self.found)])


def _table(task: Task, design: Design, outcome: RunOutcomes) -> pa.Table:
    import pyarrow as pa

    failed = np.array([bool(e) for e in outcome.errors])
    columns: dict[str, Any] = {name: design.rows[:, j] for j, name in enumerate(design.names)}
    for j, m in enumerate(task.measures):
        columns[str(m)] = pa.array(outcome.values[:, j], mask=failed)
    columns |= {"steps": outcome.steps, "ledger": pa.array(outcome.ledger, mask=failed), "error": list(outcome.errors)}
    return pa.table(columns)
