"""Many runs of one composed model in threads, and the table of what came out."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from threading import local
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu import __version__
from phfmu.sweeps.design import Design
from phfmu.sweeps.outcome import Outcome
from phfmu.sweeps.parts import Parts, digest
from phfmu.sweeps.task import Task

if TYPE_CHECKING:
    import pyarrow as pa

    from phfmu.declare.phdae import PHDAE
    from phfmu.network.run.options import Options
    from phfmu.network.scene import Scene
    from phfmu.schemes.scheme import Scheme

#: most runs that are handed to a thread at once, and how many times a thread gets some
BLOCK, TURNS = 512, 8


def sweep(
    target: Scene | PHDAE,
    design: Design,
    measures: Sequence[str],
    *,
    options: Options | None = None,
    scheme: Scheme | None = None,
    engine: str = "native",
    jobs: int | None = None,
    file: Path | None = None,
    resume: bool = False,
    progress: Callable[[int], None] | None = None,
) -> pa.Table:
    """Runs of a scene or component, one for each row of the design, told by measures such as `max(gen.w)`.

    One declaration, one compilation; the runs are shared by `jobs` threads (default: one per core), whose number does not
    change a bit of the results.  options: default the scene's (`Options(stop=.., step=..)` for a component);  engine: "native" or
    "python";  file: Parquet file of the table, with FILE.parts beside it until all is done, from which `resume` goes on;
    progress: called with the number of runs that are done.
    Table: a column per name and per measure, `steps`, `ledger` (by how much of what is allowed the energy balance of a run
    misses in its worst step: above 1 it is violated), `error` (why a run failed: its measures are null; "" if it did not).
    Errors: KeyError for names that cannot be set, ValueError for measures and options, DeclarationError, CompilerMissing.
    """
    task = _task(target, design, measures, options, scheme)
    make = _maker(task, engine)
    parts = None if file is None else Parts(file, _key(task, engine, design), resume=resume)
    outcome = taken(make, design, jobs or os.cpu_count() or 1, parts, progress or (lambda _: None))
    table = _table(task, design, outcome)
    if file is not None and parts is not None:
        from pyarrow import parquet

        parquet.write_table(table, file)
        parts.remove()
    return table


def _task(
    target: Scene | PHDAE, design: Design, texts: Sequence[str], options: Options | None, scheme: Scheme | None
) -> Task:
    from phfmu.declare.phdae import require_declaration
    from phfmu.discretise.model import build_model
    from phfmu.network.run.options import Options
    from phfmu.network.scene import Scene
    from phfmu.signals import quantities
    from phfmu.sweeps.measures import measures
    from phfmu.sweeps.places import Places

    scene = target if isinstance(target, Scene) else None
    declaration = target.declaration() if isinstance(target, Scene) else require_declaration(target, "sweep")
    if options is None:
        if scene is None:
            raise ValueError(f"{declaration.name} is no scene: options=Options(stop=.., step=..) say how it is run")
        options = Options(stop=scene.stop, step=scene.step, restart=scene.restart)
    if scene is not None and not options.events:
        options = replace(options, events=scene.events)
    model = build_model(declaration, scheme)
    Places(model).require_free(design.names, options.events, options.t0)
    known = [
        q.name
        for q in quantities(model)
        if q.block not in ("parameter", "tunable", "input") and not q.block.startswith("row_")
    ]
    return Task(model, design.names, measures(texts, known), options)


def _key(task: Task, engine: str, design: Design) -> str:
    """A digest of all that outcomes depend on, of the model its equations and its numbers."""
    m = task.model
    equations = " ".join(sorted({g.kernel.function.serialize() for plan in (m.step, m.instant) for g in plan.groups}))
    numbers = [v.tolist() for v in (m.p0, m.x0, m.u0, m.a0)]
    words = (__version__, m.name, m.scheme, engine, list(map(str, task.measures)), task.options, numbers, equations)
    return digest("\n".join(map(str, words)), design)


def _maker(task: Task, engine: str) -> Callable[[], Any]:
    """Makes what takes runs, one for each thread; the first one compiles."""
    from phfmu.sweeps.general_runs import GeneralRuns
    from phfmu.sweeps.native_runs import NativeRuns, fits

    if engine not in ("native", "python"):
        raise ValueError(f"engine '{engine}': a sweep takes native or python")
    if engine == "native" and fits(task):
        return lambda: NativeRuns(task)
    from phfmu.engine.native import NativeInstance
    from phfmu.engine.python import PythonInstance

    return lambda: GeneralRuns(task, NativeInstance if engine == "native" else PythonInstance)


def taken(
    make: Callable[[], Any], design: Design, jobs: int, parts: Parts | None, progress: Callable[[int], None]
) -> Outcome:
    """All runs, in blocks that the threads take as they get ready."""
    found: dict[int, Outcome] = dict(parts.kept()) if parts is not None else {}
    known = {run for first, o in found.items() for run in range(first, first + len(o.errors))}
    size = max(1, min(BLOCK, -(-len(design.rows) // (jobs * TURNS))))
    todo = [(a, b) for a, b in _blocks(len(design.rows), size, known)]
    own, first = local(), make() if todo else None
    keep = _Keeper(found, len(known), parts, progress)

    def begin() -> None:
        own.runs = make()

    def take(a: int, b: int) -> tuple[int, Outcome]:
        return a, own.runs.take(design.rows[a:b])

    if jobs == 1 or len(todo) <= 1:
        own.runs = first
        for a, b in todo:
            keep(*take(a, b))
        return keep.joined()
    pool = ThreadPoolExecutor(min(jobs, len(todo)), initializer=begin)
    try:
        waiting: set[Future[tuple[int, Outcome]]] = {pool.submit(take, a, b) for a, b in todo}
        while waiting:
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                keep(*future.result())
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return keep.joined()


def _blocks(n: int, size: int, known: set[int]) -> list[tuple[int, int]]:
    """Ranges of runs that are not known, of at most `size`."""
    edges = [i for i in range(n + 1) if i in (0, n) or (i in known) != (i - 1 in known)]
    spans = [(a, b) for a, b in pairwise(edges) if a not in known]
    return [(i, min(i + size, b)) for a, b in spans for i in range(a, b, size)]


@dataclass
class _Keeper:
    """Blocks of runs by the number of the first one, on disk too; `done`: how many runs there are in all."""

    found: dict[int, Outcome]
    done: int
    parts: Parts | None
    progress: Callable[[int], None]

    def __call__(self, first: int, outcome: Outcome) -> None:
        self.found[first] = outcome
        self.done += len(outcome.errors)
        if self.parts is not None:
            self.parts.keep(first, outcome)
        self.progress(self.done)

    def joined(self) -> Outcome:
        return Outcome.joined([self.found[a] for a in sorted(self.found)])


def _table(task: Task, design: Design, outcome: Outcome) -> pa.Table:
    import pyarrow as pa

    failed = np.array([bool(e) for e in outcome.errors])
    columns: dict[str, Any] = {name: design.rows[:, j] for j, name in enumerate(design.names)}
    for j, m in enumerate(task.measures):
        columns[str(m)] = pa.array(outcome.values[:, j], mask=failed)
    columns |= {"steps": outcome.steps, "ledger": pa.array(outcome.ledger, mask=failed), "error": list(outcome.errors)}
    return pa.table(columns)
