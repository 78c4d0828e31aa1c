"""phfmu check: every problem of a declaration with its remedy."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE


def add_parser(verbs: Any) -> None:
    from phfmu.cli.codes import TARGET
    from phfmu.cli.options import add_grid, add_lenient

    parser = verbs.add_parser("check", help="every problem with its remedy; exit 1 if there is an error")
    parser.add_argument("target", help=TARGET)
    parser.add_argument("--strict", action="store_true", help="warnings count as errors")
    add_grid(parser)
    add_lenient(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.cli.codes import FINE, PROBLEMS
    from phfmu.target import is_fmu

    lines, errors, warnings = _of_unit(args.target) if is_fmu(args.target) else _of_model(args)
    for line in lines:
        print(line)
    counts = [_count(errors, "problem"), _count(warnings, "warning")]
    print(f"{args.target}: {', '.join(c for c in counts if c) or 'no problems'}")
    return PROBLEMS if errors or (args.strict and warnings) else FINE


def _of_unit(path: str) -> tuple[list[str], int, int]:
    from phfmu.fmu.importer.inspect import fmu_problems

    lines = fmu_problems(path)
    return lines, len(lines), 0


def _of_model(args: argparse.Namespace) -> tuple[list[str], int, int]:
    from phfmu.cli.options import scene_of
    from phfmu.network.check_scene import check_scene

    chosen = scene_of(args)
    problems = check_scene(chosen, strict=True)
    errors = sum(p.severity == "error" for p in problems)
    if not errors and not chosen.units and (declaration := chosen.declaration()).constraints:
        _print_rank(declaration)
    return [*map(str, problems), *chosen.notes], errors, len(problems) - errors + len(chosen.notes)


def _count(n: int, word: str) -> str:
    return f"{n} {word}{'s' if n != 1 else ''}" if n else ""


def _print_rank(declaration: PHDAE) -> None:
    """Redundant constraints are allowed (multipliers of least norm), but worth knowing."""
    from phfmu.terms.rank import constraint_rank

    found = constraint_rank(declaration)
    if found.redundant:
        print(found.report())
