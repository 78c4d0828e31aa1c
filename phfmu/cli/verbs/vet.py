"""phfmu vet: what units claim of themselves is tried."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.vet.process import VettingResult


def add_parser(verbs: Any) -> None:
    parser = verbs.add_parser("vet", help="what FMUs claim of themselves, tried; exit 1 where a claim is false")
    parser.add_argument("units", metavar="UNIT", nargs="+", help="X.fmu")
    parser.add_argument("--json", metavar="PATH", help="the findings as JSON; of several units a list")
    parser.add_argument("--html", metavar="PATH", help="the findings as a page")
    parser.add_argument(
        "--claim", metavar="NAME", action="append", default=[], help="try this claim only; may be repeated"
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="that a unit may take (default 60)")
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.cli.codes import FINE, PROBLEMS
    from phfmu.cli.progress import StatusLine
    from phfmu.vet.claims.claims import chosen
    from phfmu.vet.page import lines
    from phfmu.vet.process import vet

    if not 1.0 <= args.seconds < float("inf"):
        raise ValueError(f"--seconds {args.seconds:g}: expected a number of seconds from 1")
    claims = chosen(args.claim)
    _require_folders(args.json, args.html)
    found: list[VettingResult] = []
    for path in args.units:
        with StatusLine() as line:
            found.append(vet(path, args.seconds, claims, lambda claim, path=path: line(f"{path}: {claim}")))
        print("\n".join(lines(found[-1])))
    _write(args, found)
    return PROBLEMS if any(v.false for v in found) else FINE


def _require_folders(*paths: str | None) -> None:
    for path in filter(None, paths):
        if not Path(path).resolve().parent.is_dir():
            raise ValueError(f"{path}: there is no folder {Path(path).parent}; make it first")


def _write(args: argparse.Namespace, found: list[VettingResult]) -> None:
    import json

    from phfmu.vet.page import page

    told = [v.as_data() for v in found]
    if args.json:
        Path(args.json).write_text(json.dumps(told[0] if len(told) == 1 else told, indent=1) + "\n", encoding="utf-8")
    if args.html:
        Path(args.html).write_text(page(found), encoding="utf-8")
