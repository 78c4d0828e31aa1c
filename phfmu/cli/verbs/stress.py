"""phfmu stress: stiff and extreme cases, pass or fail with the criterion."""

from __future__ import annotations

import argparse
from typing import Any


def add_parser(verbs: Any) -> None:
    from phfmu.cli.codes import TARGET

    parser = verbs.add_parser("stress", help="stiff and extreme cases; exit 1 if a criterion is not met")
    parser.add_argument("target", nargs="?", help=f"{TARGET}; default: the whole matrix")
    parser.add_argument("--long", action="store_true", help="also what takes some seconds each: 1e6 steps")
    parser.add_argument("-o", "--output", metavar="DIR", help="folder for stress.md")
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from pathlib import Path

    from phfmu.cli.codes import FINE, PROBLEMS
    from phfmu.cli.progress import StatusLine
    from phfmu.files import require_folder
    from phfmu.studies.stress.case import Verdict, answer
    from phfmu.studies.stress.matrix import cases
    from phfmu.studies.stress.report import short, tally, write
    from phfmu.target import TargetError, is_fmu

    if args.target and is_fmu(args.target):
        raise TargetError(f"{args.target} is an FMU; its step cannot go back or be zero. Give the declaration")
    if args.output:
        require_folder(Path(args.output), f"-o {args.output}", "stress.md")
    found = cases(args.target)
    lines = []
    for case in found:
        if case.long and not args.long:
            continue
        with StatusLine() as at_work:
            at_work(f"{case.target}: {case.name} ...")
            lines.append(answer(case))
        print(short(lines[-1]), flush=True)
    print(tally(lines))
    if args.output:
        arguments = " ".join(a for a in (args.target, "--long" if args.long else "") if a)
        print(f"page: {write(lines, args.output, arguments)}")
    return PROBLEMS if any(line.verdict is Verdict.FAIL for line in lines) else FINE
