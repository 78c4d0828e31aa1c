"""phfmu check: every problem of a declaration with its remedy."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE


def add_parser(verbs: Any) -> None:
    from phfmu.cli import TARGET

    parser = verbs.add_parser("check", help="every problem with its remedy; exit 1 if there is any")
    parser.add_argument("target", help=TARGET)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.cli import FINE, PROBLEMS
    from phfmu.cli.target import is_fmu, scene

    if is_fmu(args.target):
        from phfmu.fmu.inspect import fmu_problems

        problems = [str(p) for p in fmu_problems(args.target)]
    else:
        from phfmu.declare.check import check

        declaration = scene(args.target).declaration()
        problems = [str(p) for p in check(declaration)]
        if declaration.constraints and not problems:
            _print_rank(declaration)
    for problem in problems:
        print(problem)
    print(
        f"{args.target}: {len(problems)} problem{'s' if len(problems) != 1 else ''}"
        if problems
        else f"{args.target}: no problems"
    )
    return PROBLEMS if problems else FINE


def _print_rank(declaration: PHDAE) -> None:
    """Redundant constraints are allowed (multipliers of least norm), but worth knowing."""
    from phfmu.discretise.rank import constraint_rank

    found = constraint_rank(declaration)
    if found.redundant:
        print(found.report())
