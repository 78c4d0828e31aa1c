"""phfmu bench: published results reproduced."""

from __future__ import annotations

import argparse
from typing import Any


def add_parser(verbs: Any) -> None:
    parser = verbs.add_parser("bench", help="reproduce published results")
    parser.add_argument("target", help="four_particle")
    parser.add_argument("--paper", action="store_true", help="figures, table and statements of the model's paper")
    parser.add_argument(
        "-o", "--output", default="bench", metavar="DIR", help="folder for PNG and CSV (default: bench)"
    )
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from importlib.util import find_spec

    from phfmu.bench.paper import write
    from phfmu.cli import FINE, PROBLEMS
    from phfmu.cli.target import load

    if args.target != "four_particle" or not args.paper:
        raise ValueError("bench knows: phfmu bench four_particle --paper -o DIR")
    if find_spec("matplotlib") is None:
        raise ValueError('figures need matplotlib: pip install "phfmu[plot]"')
    found = write(load(args.target), args.output)
    for s in found:
        print(f"{'yes' if s.holds else 'NO '}  {s.number:12.4g}  {s.text}" + (f" ({s.remark})" if s.remark else ""))
    print(f"figures 3 to 6, table 1 and statements.csv in {args.output}")
    return FINE if all(s.holds or s.remark for s in found) else PROBLEMS
