"""phfmu sweep: many runs of a target that differ in some values, and a table of what is measured of each."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from phfmu.words import counted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pyarrow as pa

    from phfmu.declare.phdae import PHDAE
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.network.scene import Scene
    from phfmu.runs.options import Options
    from phfmu.sweeps.design import Design
    from phfmu.sweeps.worker_pool import Scheduler

#: options of a sweep that its runs do not depend on
NOT_OF_A_RUN = (
    "call",
    "verb",
    "vary",
    "table",
    "measure",
    "output",
    "resume",
    "folder",
    "scheduler",
    "scheduler_file",
    "jobs",
    "lanes",
    "quiet",
)
#: failed runs whose reasons are printed
FAILURES = 5


def add_parser(verbs: Any) -> None:
    from phfmu.cli import options, stepping
    from phfmu.cli.codes import TARGET
    from phfmu.cli.settings import add_settings
    from phfmu.cli.sound import add_no_check
    from phfmu.sweeps.words import FORMS, KINDS

    parser = verbs.add_parser("sweep", help="many runs with other values; one table of measures")
    parser.add_argument("target", help=TARGET)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--vary", action="append", default=[], metavar="AXIS",
                      help=f"{FORMS}: of a parameter, a state's start or an input; several: all combinations")  # fmt: skip
    what.add_argument("--table", metavar="FILE", help="one run a row: .csv or .parquet, its columns are the names")
    parser.add_argument("--measure", action="append", default=[], metavar="KIND(SIGNAL)", required=True,
                        help="; ".join(f"{name}: {line}" for name, line in KINDS.items())
                        + "; a pattern such as max(*.w) means one for each signal; may be repeated")  # fmt: skip
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="table of the runs, .parquet or .csv; phfmu plot draws it"
    )
    parser.add_argument("--resume", action="store_true", help="go on with a sweep of the same command that ended early")
    parser.add_argument("--keep", metavar="DIR", dest="folder",
                        help="folder for the whole result of each run (000000.parquet, ..), by the run loop: slower")  # fmt: skip
    parser.add_argument("--scheduler", metavar="ADDRESS",
                        help="of a Dask cluster whose workers take the runs: tcp://..")  # fmt: skip
    parser.add_argument("--scheduler-file", metavar="FILE", help="the same by the file that the scheduler wrote")
    parser.add_argument("--jobs", type=int, metavar="N",
                        help="threads (default: one per core); the results do not depend on their number")  # fmt: skip
    parser.add_argument("--no-lanes", action="store_false", dest="lanes",
                        help="step each run by itself, not several side by side: the same results, slower")  # fmt: skip
    parser.add_argument("--stop", type=float, help="stop time in s (default: the scene's)")
    parser.add_argument("--step", type=float, help="step in s (default: the scene's)")
    stepping.add_engine(parser, ("auto", "python", "native"))
    stepping.add_stepping(parser)
    stepping.add_coupling(parser)
    options.add_scheme(parser)
    options.add_steps(parser)
    add_settings(parser)
    add_no_check(parser)
    options.add_lenient(parser)
    options.add_grid(parser)
    stepping.add_units(parser)
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    parser.set_defaults(call=call, project=False, keep=[], input=None, fmi=None, audit="summary", audit_rtol=1e-11)


def call(args: argparse.Namespace) -> int:
    from time import perf_counter

    from phfmu.cli.codes import FINE, LEDGER, NO_CONVERGENCE
    from phfmu.cli.options import scene_of
    from phfmu.cli.progress import ProgressBar
    from phfmu.sweeps import design
    from phfmu.sweeps.runs import sweep
    from phfmu.target import is_fmu

    if args.dense is not None:
        raise ValueError("--dense is for the rows of one run; leave it out of a sweep")
    if args.jobs is not None and args.jobs < 1:
        raise ValueError(f"--jobs {args.jobs}: expected a number from 1")
    file = _file(args)
    scheduler, folder = _scheduler(args), _folder(args)
    runs = design.table(args.table) if args.table else design.axes(args.vary)
    s = None if is_fmu(args.target) else scene_of(args)
    anywhere = scheduler is not None
    taken = _apart(args, runs, anywhere) if s is None or _is_apart(args, s) else _composed(args, s, runs, anywhere)
    begun, notes = perf_counter(), list[str]()
    with ProgressBar("runs", len(runs.rows), args.quiet) as bar:
        table = sweep(
            design=runs, measures=args.measure, scheduler=scheduler, file=file, resume=args.resume, keep=folder, progress=bar,
            lanes=args.lanes, told=notes.append, **taken,
        )  # fmt: skip
    errors = table["error"].to_pylist()
    failed, worst = sum(map(bool, errors)), max((v for v in table["ledger"].to_pylist() if v is not None), default=0.0)
    if not args.quiet:
        _print(args, runs, table, failed, worst, perf_counter() - begun)
        print(*notes, sep="\n", end="\n" if notes else "")
    if failed == len(runs.rows):
        return NO_CONVERGENCE
    return LEDGER if worst > 1 else FINE


def _is_apart(args: argparse.Namespace, s: Scene) -> bool:
    """Whether each run has a stepper of its own: there are units, or members are to be stepped apart."""
    from phfmu.cli.stepping import asked_apart
    from phfmu.network.couplings.coupling_table import COUPLINGS

    coupling = args.coupling not in (None, "auto") and COUPLINGS[args.coupling].apart
    return bool(s.units) or coupling or asked_apart(args)


def _composed(args: argparse.Namespace, s: Scene, runs: Design, anywhere: bool) -> dict[str, Any]:
    """Arguments of `sweep` for runs of one composed model; `anywhere`: other processes take them."""
    from functools import partial

    from phfmu.cli import options
    from phfmu.cli.job import with_given
    from phfmu.cli.stepping import engine_of

    scene = with_given(args, s)
    declaration = scene.declaration()
    _require_sound(args, declaration, runs)
    return {
        "target": partial(_again, _anywhere(args)) if anywhere else scene,
        "options": options.of_run(args, scene, whole=True), "engine": engine_of(args.engine),
        "scheme": options.scheme_of(args, declaration), "jobs": args.jobs,
    }  # fmt: skip


def _again(args: argparse.Namespace) -> Scene:
    """The scene that is composed, in another process."""
    from phfmu.cli.job import with_given
    from phfmu.cli.options import scene_of

    return with_given(args, scene_of(args))


def _apart(args: argparse.Namespace, runs: Design, anywhere: bool) -> dict[str, Any]:
    """Arguments of `sweep` for runs of members apart or of units; what a run would tell stands on stderr once.

    Units in this process are taken by one thread unless more are asked for: their libraries may share what they keep.
    """
    import sys
    from functools import partial
    from hashlib import sha256

    from phfmu.cli.job import job_of
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.network.members.engine_member import EngineMember
    from phfmu.sweeps.recipe import Steppers, words_of

    for name, column in zip(runs.names, runs.rows.T, strict=True):
        for value in sorted({float(column.min()), float(column.max())}):
            job_of(_with(args, {name: value}))  # its values are sound, or refused here
    job = job_of(args)
    files, stepper = _unit_files(args, job.scene), job.build()
    for note in job.notes:
        print(f"phfmu: {note}", file=sys.stderr)
    asked = [f"{name}={value}" for name, value in sorted(vars(args).items()) if name not in NOT_OF_A_RUN]
    members = stepper.joined.members if isinstance(stepper, Coupled) else ()
    models = [w for m in members if isinstance(m, EngineMember) for w in words_of(m.model)]
    units = [sha256(file.read_bytes()).hexdigest() for file in files]
    one = files and not (anywhere or args.isolate or args.isolate_timeout)
    made = partial(_stepper, _anywhere(args) if anywhere else args)
    return {"target": Steppers(made, (*asked, *models, *units)), "jobs": args.jobs or (1 if one else None)}


def _unit_files(args: argparse.Namespace, s: Scene) -> list[Path]:
    from pathlib import Path

    from phfmu.target import is_fmu

    return [Path(args.target)] if is_fmu(args.target) else [u.path for u in s.units.values()]


def _with(args: argparse.Namespace, values: Mapping[str, float]) -> argparse.Namespace:
    given = [f"{name}={value!r}" for name, value in values.items()]
    return argparse.Namespace(**(vars(args) | {"set": [*args.set, *given]}))


def _stepper(args: argparse.Namespace, values: Mapping[str, float]) -> tuple[Stepper, Options]:
    """Stepper and options of `phfmu run` with these values."""
    from dataclasses import replace

    from phfmu.cli import options
    from phfmu.cli.job import job_of
    from phfmu.cli.timeline import timeline

    own = _with(args, values)
    job = job_of(own)
    stepper = job.build()
    events, _, _ = timeline(own, job.scene, stepper.settable())
    return stepper, replace(options.of_run(own, job.scene, whole=job.whole), events=events)


def _scheduler(args: argparse.Namespace) -> Scheduler | None:
    """The cluster that is asked for; two of them raise ValueError."""
    from phfmu.sweeps.worker_pool import Scheduler

    if args.scheduler and args.scheduler_file:
        raise ValueError("--scheduler and --scheduler-file name two schedulers; leave one of them out")
    found = Scheduler(args.scheduler or "", args.scheduler_file or "")
    return found if found != Scheduler() else None


def _anywhere(args: argparse.Namespace) -> argparse.Namespace:
    """With the path of a target in a file that does not depend on the present folder."""
    from pathlib import Path

    path, colon, function = args.target.partition(".py:")
    target = f"{Path(f'{path}.py').resolve()}:{function}" if colon else args.target
    return argparse.Namespace(**(vars(args) | {"target": target}))


def _folder(args: argparse.Namespace) -> Path | None:
    """The folder of whole results; one that has some raises ValueError, unless they are gone on with."""
    from pathlib import Path

    if args.folder is None:
        return None
    path = Path(args.folder).absolute()
    if not args.resume and path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise ValueError(f"--keep {args.folder} is there already and not an empty folder; name another one")
    return path


def _file(args: argparse.Namespace) -> Path | None:
    """The file of the table; what cannot be written raises ValueError before any run."""
    from pathlib import Path

    if args.output is None:
        if args.resume:
            raise ValueError("--resume goes on with the table of -o FILE; name it")
        return None
    path = Path(args.output)
    if path.suffix not in (".parquet", ".csv"):
        raise ValueError(f"-o {args.output}: the ending must be .parquet or .csv")
    if not path.parent.is_dir():
        raise ValueError(f"-o {args.output}: there is no folder {path.parent}")
    return path


def _require_sound(args: argparse.Namespace, declaration: PHDAE, runs: Design) -> None:
    """Raise ValueError with the problems of the least and the greatest value that each parameter takes."""
    from phfmu.cli.sound import require_sound
    from phfmu.network.scene import Event

    require_sound(args, declaration)
    ends = [(n, v) for n, column in zip(runs.names, runs.rows.T, strict=True) for v in (column.min(), column.max())]
    require_sound(args, declaration, [Event(0.0, name, float(v)) for name, v in ends])


def _print(args: argparse.Namespace, runs: Design, table: pa.Table, failed: int, worst: float, seconds: float) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    n = len(runs.rows)
    print(
        f"{args.target}: {counted(n, 'run')} of {counted(sum(table['steps'].to_pylist()), 'step')} in all, {seconds:.3g} s"
    )
    view = Table(box=box.SIMPLE)
    for title in ("measure", "least", "at", "greatest", "at"):
        view.add_column(title, justify="left" if title in ("measure", "at") else "right")
    for name in table.column_names[len(runs.names) : -3]:
        values = [(v, i) for i, v in enumerate(table[name].to_pylist()) if v is not None]
        if values:
            ends = [(f"{v:.6g}", _run(runs, i)) for v, i in (min(values), max(values))]
            view.add_row(name, *ends[0], *ends[1])
    Console(width=None if _terminal() else 200).print(view)
    for text, count in _reasons(table)[:FAILURES] if failed else ():
        print(f"{counted(count, 'run')} failed: {text}")
    print(
        f"energy balance: worst step misses {worst:.2g} of what is allowed ({'closed' if worst <= 1 else 'VIOLATED'})"
    )
    if args.output:
        print(f"table: {args.output}")


def _terminal() -> bool:
    import sys

    return sys.stdout.isatty()


def _run(runs: Design, i: int) -> str:
    """The run with what varies, e.g. `k13 = 40, m[1] = 2`."""
    return ", ".join(f"{name} = {v:.6g}" for name, v in zip(runs.names, runs.rows[i], strict=True))


def _reasons(table: pa.Table) -> list[tuple[str, int]]:
    """Why runs failed and how many did so, the most frequent first; numbers aside, the first words tell."""
    from collections import Counter

    first: dict[str, str] = {}
    found: Counter[str] = Counter()
    for error in filter(None, table["error"].to_pylist()):
        key = error.partition(" at t")[0].partition(":")[0]
        found[first.setdefault(key, error)] += 1
    return found.most_common()
