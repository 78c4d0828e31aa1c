"""--accuracy: the run again in finer steps, and what changed by signal."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

from phfmu.outcome.status import StepFailure
from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.runs.accuracy import Accuracy, RefinementChange, RepeatRecord, RunRecord
    from phfmu.runs.options import Options

#: most signals of which lines are printed
LINES = 20
#: adaptive runs are repeated with the tolerance over this
TIGHTER = 10.0
#: an observed order that is lower by this is told
LOWER = 0.5


def require_fit(args: argparse.Namespace) -> None:
    """Raise ValueError for options that give the rows of a run times of their own."""
    if not args.accuracy:
        return
    for option, given in (("--ecco", args.ecco), ("--energy-rtol", args.energy_rtol)):
        if given is not None:
            raise ValueError(
                f"--accuracy compares rows at equal times, and steps by {option} have others; take equal steps"
            )
    if args.rtol is not None and not args.step:
        raise ValueError(
            "--accuracy compares rows at equal times: with --rtol give --step too, whose multiples all runs land on"
        )


def recorded(args: argparse.Namespace, step: float) -> RunRecord | None:
    """The recorder of the rows of the run that is to be compared, None without --accuracy."""
    if not args.accuracy:
        return None
    from phfmu.runs.accuracy import RunRecord

    return RunRecord(step)


def print_accuracy(args: argparse.Namespace, record: RunRecord, order: float | None, chosen: Options) -> None:
    """Runs again, in finer and in coarser steps; the table, and what it says of the finished run, whose rows are in `record`.

    order: as declared, None for units, whose errors are taken to be of order 1.  StepFailure of the finer run.
    """
    from phfmu.runs.accuracy import accuracy

    notes, coarser, ratio = list[str](), None, 2.0 if order is None else 2.0**order
    try:
        finer = _again(args, record, 0.5)
    except StepFailure as failure:
        failure.add_note("this was the run of --accuracy with finer steps; the run itself went to its end")
        raise
    if args.rtol is not None:
        ratio = TIGHTER
        notes.append("errors of adaptive steps are taken to be in proportion to the tolerance")
    elif order is None:
        notes.append("no order of units is known: their errors are taken to be halved with the communication step")
    else:
        try:
            coarser = _again(args, record, 2.0)
        except (StepFailure, ValueError) as failure:
            notes.append(f"steps of {2 * record.step:g} s do not go, so errors are of the declared order: {failure}")
    _print(args, accuracy(record, finer, coarser, ratio, order if args.rtol is None else None), notes, chosen)


def _again(args: argparse.Namespace, record: RunRecord, factor: float) -> RepeatRecord:
    """Run again with other steps and return the rows at the times of the record."""
    from phfmu.cli import options
    from phfmu.cli.job import job_of
    from phfmu.cli.progress import ProgressBar
    from phfmu.cli.timeline import timeline
    from phfmu.interrupt import DeferredInterrupt
    from phfmu.runs.accuracy import RepeatRecord
    from phfmu.runs.loop import run

    args, rows = _changed(args, record.step, factor), RepeatRecord(record, record.step)
    job = job_of(args)
    chosen, stepper = options.of_run(args, job.scene, whole=job.whole), job.build()
    events, inputs, _ = timeline(args, job.scene, stepper.settable())
    with DeferredInterrupt() as signals, ProgressBar("simulating again", chosen.stop) as bar:

        def progress(t: float) -> None:
            bar(t)
            signals.check()

        chosen = replace(
            chosen, events=events, signals=tuple(args.signals), progress=progress, columns=rows.columns, keep=rows.keep,
            happened=rows.event,
        )  # fmt: skip
        run(stepper, chosen, inputs=inputs, interpolate=args.interpolate)
    return rows


def _changed(args: argparse.Namespace, step: float, factor: float) -> argparse.Namespace:
    """The command line of a run with other steps, without outputs."""
    values = vars(args) | {
        "output": None,
        "plot": None,
        "audit": "none",
        "every": None,
        "quiet": True,
        "accuracy": False,
    }
    if args.rtol is not None:
        values["rtol"] = args.rtol / TIGHTER
    else:
        values["step"] = factor * step
    return argparse.Namespace(**values)


def _print(args: argparse.Namespace, found: Accuracy, notes: list[str], chosen: Options) -> None:
    """The table, and what it says of the run."""
    finer = f"rtol {args.rtol / TIGHTER:g}" if args.rtol is not None else f"steps of {0.5 * chosen.step:g} s"
    print(
        f"accuracy: the run again with {finer}; the largest change of each signal, and the error of this run that it tells"
    )
    shown = [c for c in found.changes if c.size > 0][:LINES]
    if shown:
        width = max(len("signal"), *(len(c.name) for c in shown))
        heads = (("change", 10), ("at t in s", 12), ("of range", 9), ("order", 5), ("error", 10), ("of range", 9))
        print("  ".join([f"{'signal':<{width}}", *(f"{name:>{n}}" for name, n in heads)]))
        for c in shown:
            print(f"{c.name:<{width}}  {_line(c)}")
    different = sum(c.size > 0 for c in found.changes)
    if different > len(shown):
        print(f"and {different - len(shown)} more that change less")
    equal = len(found.changes) - different
    rest = [f"{equal} did not change"] if equal else []
    rest += [f"{found.rounding} of the size of rounding beside others of their unit"] if found.rounding else []
    print(f"{counted(len(found.changes) + found.rounding, 'signal')}{': ' if rest else ''}{', '.join(rest)}")
    for line in [*found.notes, *notes, *_verdict(found)]:
        print(line)


def _line(c: RefinementChange) -> str:
    """The entries of its row behind the name."""
    order, error, part = "", "unknown", ""
    if c.error is not None:
        order = "" if c.order is None else f"{c.order:.2f}"
        error, part = f"{c.error:.3e}", f"{c.error / c.scale:.2e}"
    change = f"{c.size:>10.3e}  {c.time:>12.6g}  {c.relative:>9.2e}"
    unit = "" if c.unit == "1" else c.unit
    return f"{change}  {order:>5}  {error:>10}  {part:>9}  {unit}".rstrip()


def _verdict(found: Accuracy) -> list[str]:
    """The meaning of the observed order."""
    lost = [c for c in found.changes if c.error is None]
    lines = []
    if lost:
        lines.append(
            f"{counted(len(lost), 'signal')} ({lost[0].name}) do not come closer with smaller steps: what they follow is faster "
            "than a step, or jumps with it; their error is not known"
        )
    seen = found.observed
    if seen is not None and found.order is not None:
        low = " which is lower: events, held inputs, hidden constraints or fast decay cost order, or steps are long" if (
            seen < found.order - LOWER
        ) else ""  # fmt: skip
        lines.append(
            f"order {found.order:g} declared, {seen:.2f} observed (median of the signals){',' if low else ''}{low}"
        )
    return lines
