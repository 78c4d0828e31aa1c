"""phfmu report: the page of a run."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.report.page.page import Run


def add_parser(verbs: Any) -> None:
    parser = verbs.add_parser(
        "report", help="HTML page of a run: diagram, energy flows, books, signals, verdict; exit 4 as audit"
    )
    parser.add_argument("files", metavar="RUN|AUDIT", nargs="+",
                        help="audits and result tables of phfmu run; NAME.csv belongs to NAME.audit.parquet")  # fmt: skip
    parser.add_argument("-o", "--output", metavar="PATH", required=True, help="X.html; a folder for several runs")
    parser.add_argument("--window", metavar="A:B", help="times in s that are shown and summed; either may be left out")
    parser.add_argument("--signals", metavar="SIGNAL", nargs="+", default=[],
                        help="names or patterns of the result table; default: as phfmu plot")  # fmt: skip
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.cli.codes import FINE, LEDGER
    from phfmu.cli.verbs.results.plot import window
    from phfmu.report.page.page import write_report
    from phfmu.report.picture.draw import check_picture

    span, runs = window(args.window), _runs(args)
    folder = Path(args.output)
    if len(runs) > 1 and not folder.is_dir():
        raise ValueError(
            f"-o {args.output}: {len(runs)} runs ({', '.join(r.name for r in runs)}) need a folder that exists"
        )
    pages = {r.name: folder / f"{r.name}.html" if folder.is_dir() else folder for r in runs}
    for page in pages.values():
        check_picture(page, "-o")
        if page.suffix != ".html":
            raise ValueError(f"-o {page}: the ending must be .html")
    closed = True
    for run in runs:
        written = write_report(run, pages[run.name], span)
        closed &= written.closed
        print(f"report: {pages[run.name]}")
        for note in written.notes:
            print(f"  {note}")
        if run.audit is None:
            print(
                f"  signals only; with the audit of the run also energies, events, verdict: phfmu report {run.table} AUDIT ..."
            )
        if not written.closed:
            print(f"phfmu: ledger violated: {run.name}", file=sys.stderr)
    return FINE if closed else LEDGER


def _runs(args: argparse.Namespace) -> list[Run]:
    """The files of each run; one table and one audit are one run whatever their names are."""
    from phfmu.report.opening import is_audit
    from phfmu.report.page.page import Run

    audits, tables = (
        _by_name([f for f in args.files if is_audit(f)]),
        _by_name([f for f in args.files if not is_audit(f)]),
    )
    if args.signals and not tables:
        raise ValueError("--signals names signals of a result table; give the one of the run too, e.g. RUN.csv")
    if len(audits) == 1 and len(tables) == 1:
        (name, audit), (table,) = next(iter(audits.items())), tables.values()
        return [Run(name, audit, table, args.signals)]
    return [Run(name, audits.get(name), tables.get(name), args.signals) for name in {**audits, **tables}]


def _by_name(files: Sequence[str]) -> dict[str, str]:
    named: dict[str, str] = {}
    for file in files:
        name = Path(file).name.partition(".")[0]
        if name in named:
            raise ValueError(f"{named[name]} and {file} would both be the run '{name}'; give them one after the other")
        named[name] = file
    return named
