"""phfmu run: simulate a target, write results and the audit."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any

from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.audit.summary import LedgerSummary
    from phfmu.cli.outputs import Outputs
    from phfmu.discretise.start import Projection
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.network.scene import Event, Scene
    from phfmu.runs.accuracy import RunRecord
    from phfmu.runs.inputs.input_rows import InputRows
    from phfmu.runs.options import Options
    from phfmu.runs.result import Result


#: lines about what was left out that a run prints
NOTES = 12


def add_parser(verbs: Any) -> None:
    from phfmu.cli import options, stepping
    from phfmu.cli.codes import TARGET
    from phfmu.cli.settings import add_settings
    from phfmu.cli.sound import add_no_check
    from phfmu.fmu.version import LATEST, VERSIONS
    from phfmu.network.members.interpolations import INTERPOLATIONS

    parser = verbs.add_parser("run", help="simulate; result table, audit")
    parser.add_argument("target", help=TARGET)
    parser.add_argument("--stop", type=float, help="stop time in s (default: the scene's)")
    parser.add_argument("--step", type=float, help="communication step in s (default: the scene's; none with --rtol)")
    options.add_scheme(parser)
    stepping.add_engine(parser, stepping.ENGINES)
    stepping.add_stepping(parser)
    parser.add_argument("--fmi", choices=tuple(VERSIONS), help=f"FMI version of --engine fmu (default {LATEST})")
    stepping.add_coupling(parser)
    options.add_steps(parser)
    add_settings(parser)
    add_no_check(parser)
    options.add_lenient(parser)
    options.add_grid(parser)
    stepping.add_units(parser)
    parser.add_argument("--input", metavar="FILE",
                        help="input and parameter values over time (.csv or .parquet, first column time)")  # fmt: skip
    parser.add_argument("--interpolate", default="held", choices=tuple(INTERPOLATIONS),
                        help="what inputs are between rows of --input: "
                        + "; ".join(f"{name}: {line}" for name, line in INTERPOLATIONS.items()) + " (default: held)")  # fmt: skip
    _add_outputs(parser)
    parser.add_argument("--project", action="store_true",
                        help="move an inconsistent start onto its constraints instead of refusing it")  # fmt: skip
    parser.add_argument("--keep", action="append", default=[], metavar="NAME",
                        help="a state that --project leaves as it is (v: all of v); may be repeated")  # fmt: skip
    parser.add_argument("--accuracy", action="store_true",
                        help="run again with half the step and tell by how much each signal changes, and the error of this "
                        "run that follows")  # fmt: skip
    parser.add_argument("--checkpoint", type=float, metavar="SECONDS",
                        help="keep where the run is this often, in X.checkpoint beside -o or --audit")  # fmt: skip
    parser.add_argument("--resume", metavar="FILE",
                        help="go on from a checkpoint of the same command line, to the same bits")  # fmt: skip
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    parser.set_defaults(call=call)


def _add_outputs(parser: argparse.ArgumentParser) -> None:
    """The options about what is written and told of a run."""
    parser.add_argument("-o", "--output", metavar="FILE", help="result table, .csv or .parquet")
    parser.add_argument("--signals", action="append", default=[], metavar="PATTERN",
                        help="columns to keep, by name or pattern ('gen.*'); may be repeated (default: all)")  # fmt: skip
    parser.add_argument("--sensitivity", metavar="NAME,NAME",
                        help="columns d(SIGNAL)/d(NAME): derivatives by parameters, start values or held inputs; one composed "
                        "model, or members stepped apart by newton coupling; equal steps")  # fmt: skip
    parser.add_argument("--every", metavar="N|TIMEs",
                        help="rows to keep: every Nth, or one each 0.01s; the last row stays (default: all)")  # fmt: skip
    parser.add_argument(
        "--units-row",
        action="store_true",
        help="a second line of units in CSV (X.columns.json beside it and Parquet have them always)",
    )
    parser.add_argument("--audit", metavar="none|summary|full|FILE", default="summary",
                        help="energy ledger: none; sums, printed (default); a file per step, FILE.parquet or "
                             "(full) TARGET.audit.parquet")  # fmt: skip
    parser.add_argument("--audit-detail", action="store_true",
                        help="tell each energy and each resistor by itself too (phfmu audit FILE --by term); one composed "
                             "model only")  # fmt: skip
    parser.add_argument("--hash-states", type=int, default=0, metavar="N",
                        help="each N steps hashes of the states of each member in the audit file: phfmu replay tells where "
                             "they differ")  # fmt: skip
    parser.add_argument("--plot", metavar="FILE", help="picture of the run, X.png or X.html (see: phfmu plot)")
    parser.add_argument("--view", metavar="FILE", help="the motion of a mechanism, X.html or X.gif (see: phfmu view)")
    parser.add_argument(
        "--audit-rtol", type=float, default=1e-11, help="allowed residual of a step relative to the energies in play"
    )


def call(args: argparse.Namespace) -> int:
    from time import perf_counter

    from phfmu.cli import accuracy, options
    from phfmu.cli.checkpoints import CheckpointFile
    from phfmu.cli.codes import FINE, LEDGER
    from phfmu.cli.job import job_of
    from phfmu.cli.outputs import Outputs
    from phfmu.cli.progress import ProgressBar
    from phfmu.cli.sound import require_sound_scene
    from phfmu.cli.timeline import timeline
    from phfmu.interrupt import DeferredInterrupt
    from phfmu.runs.loop import run
    from phfmu.signals import derivative_name
    from phfmu.target import is_fmu

    accuracy.require_fit(args)
    checkpoints = CheckpointFile(args)
    outputs, job = Outputs(args, checkpoints), job_of(args)
    chosen, scene, label = options.of_run(args, job.scene, whole=job.whole), job.scene, job.label
    stepper = job.build()
    events, rows, dropped = timeline(args, scene, stepper.settable())
    signals = tuple(args.signals)
    if args.sensitivity and signals:
        signals += (derivative_name("*", "*"),)
    chosen = replace(chosen, events=events, signals=signals, every=_every(args.every), hash_states=args.hash_states)
    if checkpoints.asked:
        chosen = replace(chosen, checkpoints=checkpoints)
        checkpoints.begin(stepper, chosen, outputs.marks)
    changes = [e for e in (*events, *_of_parameters(stepper, rows)) if e.t < chosen.stop]
    if changes and not is_fmu(args.target):
        require_sound_scene(args, scene, changes)
    begun = perf_counter()
    with DeferredInterrupt() as signals, outputs, ProgressBar("simulating", chosen.stop, args.quiet) as bar:

        def progress(t: float) -> None:
            bar(t)
            signals.check()

        held = rows.events() if rows is not None and args.interpolate == "held" else ()
        marks = (e for e in chain(events, held) if e.t < chosen.stop)
        about = {"target": args.target, "run": label, "kernels": job.kernels.words}
        outputs.begin(about, scene.shapes, () if args.signals else scene.shown)
        record = accuracy.recorded(args, chosen.step)
        recorded = replace(_recorded(chosen, outputs, marks, record), progress=progress)
        result = run(stepper, recorded, inputs=rows, interpolate=args.interpolate)
        seconds = perf_counter() - begun - outputs.seconds
    summary = result.ledger.summary()
    if not args.quiet:
        _print_run(args, label + job.kernels.words, result, chosen, seconds)
        _print_notes([*job.notes, *dropped, *result.notes, *outputs.notes])
        if chosen.audited:
            _print_ledger(summary)
    if record is not None:
        accuracy.print_accuracy(args, record, job.order, chosen)
    if summary.closed:
        return FINE
    _print_violated(result, None if is_fmu(args.target) or scene.units else scene, changes)
    return LEDGER


def _recorded(chosen: Options, outputs: Outputs, marks: Iterator[Event], record: RunRecord | None) -> Options:
    """The options with all that takes columns, rows and events of the run: its files, and the record of --accuracy."""
    return replace(
        chosen, sink=outputs.sink, columns=both(partial(outputs.columns, chosen, marks), record and record.columns),
        keep=both(outputs.keep, record and record.keep), happened=both(outputs.happened, record and record.event),
    )  # fmt: skip


def _print_ledger(summary: LedgerSummary) -> None:
    """The tables of the ledger, of large ones the rows that matter most."""
    from phfmu.audit.tables.report import summary_table
    from phfmu.audit.tables.sheet_names import ROWS

    print(summary_table(summary, most=ROWS), end="")


def _print_violated(result: Result, declared: Scene | None, events: Sequence[Event]) -> None:
    """The violations, and where dissipation is negative in a `declared` scene, the entries of R that lose their sign."""
    from phfmu.audit.violation import ViolationKind

    summary = result.ledger.summary()
    places = dict.fromkeys(v.name for v in summary.violations)
    print(f"phfmu: ledger violated: {', '.join(places)}; worst: {summary.worst}", file=sys.stderr)
    if declared is not None:
        lost = {v.name for v in summary.violations if v.kind is ViolationKind.DISSIPATION}
        _print_signs_lost(declared, events, result, lost)


def _of_parameters(stepper: Stepper, rows: InputRows | None) -> Iterator[Event]:
    """Events of the rows that may set parameters: the inputs of ports, which may be many, have no values that are unsound."""
    from phfmu.network.couplings.stepper import Follows

    ports = stepper.free_inputs if isinstance(stepper, Follows) else {}
    names = [n for n in rows.names if n not in ports] if rows is not None else []
    return rows.events(names) if rows is not None and names else iter(())


def both(first: Callable[..., None], second: Callable[..., None] | None) -> Callable[..., None]:
    """A call of both, of one where there is no second."""
    if second is None:
        return first

    def call(*values: Any) -> None:
        first(*values)
        second(*values)

    return call


def _every(text: str | None) -> int | float | None:
    """Number of rows, or time with its unit, of --every; raises ValueError for anything else."""
    if text is None:
        return None
    try:
        return float(text[:-1]) if text.endswith("s") else int(text)
    except ValueError:
        raise ValueError(f"--every {text}: expected a number of rows (10) or a time (0.01s)") from None


def _print_signs_lost(scene: Scene, events: Sequence[Event], result: Result, components: set[str]) -> None:
    """The entries at which R of components with a negative dissipation lost its sign."""
    from phfmu.checks.matrices import sign_lost

    declaration = scene.declaration()
    for name in sorted(components & set(result.least)):
        t, signals = result.least[name]
        values = {e.name: e.value for e in sorted(events, key=lambda e: e.t) if e.t < t}
        values |= signals
        owner = name if name in declaration.members else declaration.members[0]
        for lost in sign_lost(declaration, values, t, owner)[:3]:
            print(f"phfmu: {name}: R is not positive semidefinite at t = {t:.6g} s: {lost}", file=sys.stderr)


def _tolerance(chosen: Options) -> str:
    """The tolerance that steps keep, as it was asked for."""
    given = {"rtol": chosen.rtol, "ecco": chosen.ecco, "energy rtol": chosen.energy_rtol}
    return next(f"{name} {value:g}" for name, value in given.items() if value is not None)


def _print_run(args: argparse.Namespace, label: str, result: Result, chosen: Options, seconds: float) -> None:
    its = f", {result.iterations / result.steps:.2f} iterations a step" if result.iterations else ""  # units tell none
    sizes = (
        f"step {chosen.step:g} s"
        if not chosen.adaptive
        else f"{_tolerance(chosen)}, steps {result.smallest:.3g} to {result.largest:.3g} s"
    )
    print(f"{args.target}: {label}; {sizes} to {chosen.stop:g} s: {counted(result.steps, 'step')}{its}, "
          f"{seconds:.3g} s")  # fmt: skip
    if result.projection is not None:
        _print_projection(result.projection)
    if args.rtol is not None or args.energy_rtol is not None:
        print(f"rejected: {counted(result.rejected, 'trial step')}")
    if result.restarted:
        print(f"restarted after events with {counted(result.restarted, 'damping step')}")
    groups: dict[str, float] = {}
    for name, value in result.worst.items():
        key = name.split("[")[0]
        groups[key] = max(groups.get(key, 0.0), value)
    _print_worst(groups)
    if args.output:
        print(f"results: {args.output}")
    if args.plot:
        print(f"picture: {args.plot}")
    if args.view:
        print(f"motion: {args.view}")
    from phfmu.cli.options import audit_file

    if audit := audit_file(args):
        print(f"audit: {audit} (print with: phfmu audit {audit})")


def _print_worst(groups: dict[str, float]) -> None:
    """The worst of each hidden constraint; of many, the largest."""
    told = sorted(groups, key=lambda n: -groups[n])[:NOTES] if len(groups) > NOTES else list(groups)
    for name in told:
        print(f"largest |{name}| over the run: {groups[name]:.6g}")
    if others := [value for name, value in groups.items() if name not in told]:
        print(f"and {len(others)} more of these, at most {max(others):.6g}")


def _print_notes(notes: list[str]) -> None:
    """Print the first notes about what was left out or done beside what was asked for."""
    for note in notes[:NOTES]:
        print(note)
    if len(notes) > NOTES:
        print(f"and {len(notes) - NOTES} more of these")


def _print_projection(p: Projection) -> None:
    """Equations that were violated, states that moved, the energy."""
    print(f"start projected: {counted(len(p.before), 'hidden constraint')}, {len(p.violated)} off; "
          f"{counted(len(p.moved), 'state')} moved, energy changed by {p.energy:.9g} J")  # fmt: skip
    for name in p.violated:
        print(f"  {name}: {p.before[name]:.6g} -> {p.after[name]:.2g}")
    for move in p.moves():
        print(f"  {move}")
