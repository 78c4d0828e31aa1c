"""phfmu view: the motion of a run as a page that plays it, or as an animated image."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(verbs: Any) -> None:
    from phfmu.cli.codes import TARGET
    from phfmu.cli.settings import add_settings

    parser = verbs.add_parser("view", help="the motion of a mechanism: a page to turn and play, or a GIF")
    parser.add_argument(
        "target",
        metavar="RUN|TARGET",
        help=f"result table (.csv, .parquet) of phfmu run, or what is run first: {TARGET}",
    )
    parser.add_argument(
        "-o", "--output", metavar="FILE", required=True, help="X.html (X.html#t=1.5: at that time) or X.gif"
    )
    parser.add_argument("--shapes", metavar="TARGET", help="of a table without X.shapes.json beside it: what was run")
    parser.add_argument("--stop", type=float, help="of a target: stop time in s (default: the scene's)")
    parser.add_argument("--step", type=float, help="of a target: step in s (default: the scene's)")
    parser.add_argument("--order", help="of a target: order of the scheme")
    add_settings(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.report.view.recorded import check_view

    check_view(args.output, "-o")
    table = args.target.endswith((".csv", ".parquet"))
    return _of_table(args) if table else _of_run(args)


def _of_table(args: argparse.Namespace) -> int:
    """The motion that a table tells."""
    from phfmu.cli.codes import FINE
    from phfmu.report.view.recorded import of_table, require_shapes, write
    from phfmu.target import scene

    given = [f"--{name}" for name in ("stop", "step", "order") if getattr(args, name) is not None]
    if given or args.set:
        raise ValueError(f"{(given or ['--set'])[0]} is for a target that is run; {args.target} is the table of a run")
    if not Path(args.target).is_file():
        raise FileNotFoundError(f"no file '{args.target}'; make one with: phfmu run TARGET -o {args.target}")
    shapes = ()
    if args.shapes:
        shapes = scene(args.shapes).shapes
        require_shapes(shapes, args.shapes)
    made = of_table(args.target, shapes)
    write(made, args.output)
    print(f"{args.output}: {len(made.time)} pictures from {made.time[0]:g} s to {made.time[-1]:g} s")
    return FINE


def _of_run(args: argparse.Namespace) -> int:
    """The motion of a target that is run first, as `phfmu run --view` shows it."""
    from phfmu.cli.parser import Parser
    from phfmu.cli.verbs import run

    if args.shapes:
        raise ValueError(f"--shapes is for the table of a run; {args.target} brings its own")
    words = ["run", args.target, "--view", args.output]
    for name in ("stop", "step", "order"):
        if (value := getattr(args, name)) is not None:
            words += [f"--{name}", str(value)]
    for setting in args.set:
        words += ["--set", setting]
    parser = Parser(prog="phfmu")
    run.add_parser(parser.add_subparsers(dest="verb"))
    asked = parser.parse_args(words)
    return asked.call(asked)
