"""phfmu audit: where the energy went, from an audit file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from phfmu.words import shown


def add_parser(verbs: Any) -> None:
    parser = verbs.add_parser("audit", help="table of where the energy went; exit 4 if something does not close")
    parser.add_argument("file", help="X.parquet or X.arrows; or 'recover X.arrows' after a crash", nargs="+")
    parser.add_argument(
        "--rtol", type=float, default=1e-11, help="allowed step residual relative to the energy in play"
    )
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.audit import audit_table, recover, summarise
    from phfmu.cli.codes import FINE, LEDGER
    from phfmu.network.run.options import ledger_tolerance

    ledger_tolerance(args.rtol, "--rtol")
    if args.file[0] == "recover" and len(args.file) == 2:
        found = recover(args.file[1])
        print(f"recovered {found.rows} rows into {found.path}{' (the torn end was left out)' if found.torn else ''}")
        for path in found.tables:
            print(_left(path))
        return FINE
    if len(args.file) != 1:
        raise ValueError("audit takes one file, or: audit recover FILE")
    summary = summarise(_existing(args.file[0]), args.rtol)
    print(audit_table(summary), end="")
    return FINE if summary.closed else LEDGER


def _left(path: Path) -> str:
    """What an unfinished table is good for; `path` is that of its file, its name that of the table and more."""
    if path.name.rsplit(".", 3)[1] == "parquet":
        return f"the table of -o is lost, for Parquet cannot be read without its end; {shown(str(path))} may be deleted"
    return f"the table of -o is in {shown(str(path))}; its last line may be cut off"


def _existing(path: str) -> Path:
    found = Path(path)
    if not found.is_file() and not found.with_suffix(".arrows").is_file():
        raise FileNotFoundError(f"no audit file '{path}'; write one with: phfmu run TARGET --audit {path}")
    return found
