"""phfmu plot: signals of a run or of an audit as a picture."""

from __future__ import annotations

import argparse
import re
from typing import Any


def add_parser(verbs: Any) -> None:
    parser = verbs.add_parser("plot", help="picture of a run, an audit or a sweep: PNG, or HTML to zoom into")
    parser.add_argument(
        "file",
        metavar="RUN|AUDIT|SWEEP",
        help="result table (.csv, .parquet) or audit (.parquet) of phfmu run; table of phfmu sweep: measures against what varies",
    )
    parser.add_argument("signals", metavar="SIGNAL", nargs="*", default=[],
                        help="names or patterns ('gen.*', '*.I[1]'); default: all but means, ends and books")  # fmt: skip
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="X.png or X.html")
    parser.add_argument("--events", metavar="AUDIT", help="audit whose events are marked, for a result table")
    parser.add_argument("--window", metavar="A:B", help="times in s that are shown; either may be left out")
    parser.add_argument("--size", metavar="WxH", help="pixels of a PNG, e.g. 1200x800")
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.cli.codes import FINE
    from phfmu.pick import pick
    from phfmu.report.audit_signals import HOLDS, AuditSignals, marks
    from phfmu.report.opening import opened
    from phfmu.report.page.history import read_history
    from phfmu.report.picture.draw import check_picture, draw
    from phfmu.report.picture.picture import picture, with_marks
    from phfmu.report.sweep_table import is_sweep

    check_picture(args.output, "-o")
    size = _size(args)
    if is_sweep(args.file):
        return _sweep(args, size)
    found = opened(args.file)
    asked = [found.labelled.get(s, s) for s in args.signals]
    chosen = pick(asked, found.names, args.file, HOLDS if isinstance(found, AuditSignals) else "")
    span = window(args.window)
    drawn = picture(found, chosen, span)
    if args.events:
        drawn = with_marks(drawn, marks(read_history(args.events)), span)
    draw(drawn, args.output, size)
    print(f"picture: {args.output}")
    for note in drawn.notes:
        print(note)
    return FINE


def _sweep(args: argparse.Namespace, size: tuple[int, int] | None) -> int:
    """Measures of a sweep against what varied."""
    from phfmu.cli.codes import FINE
    from phfmu.report.sweep_picture import draw_sweep
    from phfmu.report.sweep_table import read_sweep

    given = [option for option, value in (("--window", args.window), ("--events", args.events)) if value]
    if given:
        raise ValueError(f"{given[0]} is about the time of one run; {args.file} is the table of a sweep, leave it out")
    table = read_sweep(args.file).chosen(args.signals)
    draw_sweep(table, args.output, size)
    print(f"picture: {args.output}")
    for note in table.notes:
        print(note)
    return FINE


def window(text: str | None) -> tuple[float, float]:
    """Start and end [s] of A:B, of which one may be left out; raises ValueError for anything else."""
    if text is None:
        return float("-inf"), float("inf")
    first, colon, last = text.partition(":")
    try:
        start, stop = float(first or "-inf"), float(last or "inf")
    except ValueError:
        start = stop = 0.0
    if not colon or not start < stop:
        raise ValueError(f"--window {text}: expected A:B with A < B in seconds, e.g. 0.4:0.6 or 0.4:")
    return start, stop


def _size(args: argparse.Namespace) -> tuple[int, int] | None:
    if args.size is None:
        return None
    found = re.fullmatch(r"(\d+)x(\d+)", args.size)
    if not found or not all(100 <= int(n) <= 20000 for n in found.groups()):
        raise ValueError(f"--size {args.size}: expected WIDTHxHEIGHT in pixels, each from 100 to 20000, e.g. 1200x800")
    if not args.output.endswith(".png"):
        raise ValueError("--size is for a PNG; an HTML page fits its window")
    return int(found[1]), int(found[2])
