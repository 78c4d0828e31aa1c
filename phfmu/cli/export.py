"""phfmu export: native FMUs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(verbs: Any) -> None:
    from phfmu.cli import TARGET, options

    parser = verbs.add_parser("export", help="write FMI 2.0 and 3.0 Co-Simulation FMUs")
    parser.add_argument("target", help=TARGET.rsplit(" | ", 1)[0])
    parser.add_argument("-o", "--output", default=".", metavar="DIR", help="folder for the FMUs (default: here)")
    parser.add_argument("--fmi", action="append", choices=("2", "3"), help="FMI version; both if not given")
    parser.add_argument("--step", type=float, help="internal step in s (default: the scene's)")
    options.add_scheme(parser)
    parser.add_argument("--node-inputs", action="store_true",
                        help="optional port inputs at the nodes of a step, e.g. terminal.v_node[1,2] (order 4 or 6)")  # fmt: skip
    parser.add_argument("--platform", action="append", metavar="NAME", help="e.g. x86_64-linux; may be repeated")
    parser.add_argument("--all-platforms", action="store_true", help="linux, windows and darwin, x86_64 and aarch64")
    options.add_settings(parser)
    options.add_no_check(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.cli.build import _with_settings
    from phfmu.cli.options import require_sound, scheme_of, settings
    from phfmu.cli.target import scene
    from phfmu.discretise.model import build_model
    from phfmu.fmu.export import PLATFORMS, export

    s = scene(args.target)
    system = _with_settings(s.system, settings(args.set))
    declaration = type(s)(s.name, system, s.stop, s.step).declaration()
    require_sound(args, declaration)
    step = args.step if args.step is not None else s.step
    if not step > 0:
        raise ValueError(f"--step {step} s must be positive")
    if Path(args.output).exists() and not Path(args.output).is_dir():
        raise ValueError(f"-o {args.output} is a file; name a folder for the FMUs")
    versions = tuple(f"{v}.0" for v in (args.fmi or ("2", "3")))
    platforms = list(PLATFORMS) if args.all_platforms else args.platform
    model = build_model(declaration, scheme_of(args, declaration))
    paths = export(declaration, model, args.output, versions=versions, step=step, stop=s.stop, platforms=platforms,
                   node_inputs=args.node_inputs)  # fmt: skip
    for path in paths:
        print(path)
    return 0
