"""phfmu compare: two runs signal by signal."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.report.compare import Comparison, SignalDifference

#: most signals of which lines are printed
LINES = 20


def add_parser(verbs: Any) -> None:
    parser = verbs.add_parser(
        "compare", help="two runs or audits: largest difference per signal, exit code 1 beyond a tolerance"
    )
    for name in ("a", "b"):
        parser.add_argument(
            name, metavar=name.upper(), help="result table (.csv, .parquet) or audit (.parquet) of phfmu run"
        )
    parser.add_argument(
        "signals", metavar="SIGNAL", nargs="*", default=[], help="names or patterns; default: all that both have"
    )
    parser.add_argument("--rtol", type=float, default=1e-9,
                        help="allowed difference relative to the largest magnitude of the signal, of energies to that of "
                        "all (default 1e-9)")  # fmt: skip
    parser.add_argument("--atol", type=float, default=0.0, help="the same absolutely, added (default 0)")
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.cli.codes import FINE, PROBLEMS
    from phfmu.pick import pick
    from phfmu.report.compare import common, compare
    from phfmu.report.opening import opened

    for name in ("rtol", "atol"):
        if not 0 <= getattr(args, name) < float("inf"):
            raise ValueError(f"--{name} {getattr(args, name)}: expected a number from 0")
    a, b = opened(args.a), opened(args.b)
    if type(a) is not type(b) and not common(a, b):
        raise ValueError(
            f"{args.a} and {args.b}: one is the table of a run, the other an audit, without a common signal; compare two of "
            "a kind"
        )
    names = None
    if args.signals:
        names = pick(args.signals, common(a, b), f"what {args.a} and {args.b} have in common")
    found = compare(a, b, names)
    beyond = [d for d in found.differences if not d.within(args.rtol, args.atol)]
    _print(args, found, beyond)
    return PROBLEMS if beyond else FINE


def _print(args: argparse.Namespace, found: Comparison, beyond: list[SignalDifference]) -> None:
    shown = [d for d in found.differences if d.size > 0][:LINES]
    if shown:
        width = max(len(d.name) for d in shown)
        print(f"{'signal':<{width}}  {'relative':>9}  {'difference':>10}  {'at t in s':>12}  {'A':>13}  {'B':>13}")
    for d in shown:
        mark = "" if d.within(args.rtol, args.atol) else "  beyond"
        print(
            f"{d.name:<{width}}  {d.relative:>9.2e}  {d.size:>10.3e}  {d.time:>12.6g}  {d.a:>13.6g}  {d.b:>13.6g}{mark}"
        )
    different = sum(d.size > 0 for d in found.differences)
    if different > len(shown):
        print(f"and {different - len(shown)} more that differ less")
    allowed = f"rtol {args.rtol:g}" + (f", atol {args.atol:g}" if args.atol else "")
    equal, within = len(found.differences) - different, different - len(beyond)
    print(
        f"{counted(len(found.differences), 'signal')}: {equal} equal, {within} within {allowed}, {len(beyond)} beyond"
    )
    for file, alone in ((args.a, found.only_a), (args.b, found.only_b)):
        if alone and not args.signals:
            print(f"only in {file}: {', '.join(alone[:5])}{f' and {len(alone) - 5} more' if len(alone) > 5 else ''}")
    for note in found.notes:
        print(note)
