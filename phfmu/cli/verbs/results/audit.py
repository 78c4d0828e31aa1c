"""phfmu audit: where the energy went, from an audit file."""

from __future__ import annotations

import argparse
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phfmu.words import counted, shown

if TYPE_CHECKING:
    from phfmu.audit.log.window import Window


def add_parser(verbs: Any) -> None:
    from phfmu.audit.tables.sheet_names import KINDS, ROWS, UNITS

    parser = verbs.add_parser("audit", help="table of where the energy went; exit 4 if something does not close")
    parser.add_argument("file", help="X.parquet or X.arrows; or 'recover X.arrows' after a crash", nargs="+")
    parser.add_argument(
        "--rtol", type=float, default=1e-11, help="allowed step residual relative to the energy in play"
    )
    parser.add_argument("--window", metavar="A:B", help="sums of the steps from A to B s only; A or B may be left out")
    parser.add_argument("--by", choices=KINDS, help="one table only; event: all events, one by one")
    parser.add_argument("--all", action="store_true",
                        help=f"all rows; else, without --by, {ROWS} of a table, the last the sum of all others")  # fmt: skip
    parser.add_argument("--unit", choices=(*UNITS, "auto"), help="of the energies (default J; auto: what fits)")
    parser.add_argument(
        "--percent", action="store_true", help="energies as shares of what flowed: came in, or was stored before"
    )
    parser.add_argument("--export", choices=("csv",), help="the table of --by as CSV, with all digits, instead of text")
    parser.add_argument(
        "--why", action="store_true", help="sentences instead: who made energy, by what, when, and what to do about it"
    )
    parser.add_argument("--alarm", type=float, default=0.1, metavar="PART",
                        help="warn of steps that miss more than this part of what is allowed (default 0.1)")  # fmt: skip
    parser.add_argument("--alarm-junction", type=float, default=1e-6, metavar="PART",
                        help="warn of junctions that created more than this part of what passed (default 1e-6)")  # fmt: skip
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.audit import audit_table, recover, summarise
    from phfmu.audit.alarms import Alarms
    from phfmu.audit.log.window import event_rows
    from phfmu.audit.tables.report import audit_csv
    from phfmu.audit.tables.sheet_names import ROWS
    from phfmu.audit.tables.sheets import Scale, fitting, shares
    from phfmu.cli.codes import FINE, LEDGER
    from phfmu.runs.options import ledger_tolerance

    ledger_tolerance(args.rtol, "--rtol")
    if args.file[0] == "recover" and len(args.file) == 2:
        found = recover(args.file[1])
        print(f"recovered {found.rows} rows into {found.path}{' (the torn end was left out)' if found.torn else ''}")
        if found.damaged:
            print(
                f"{counted(found.damaged, 'batch')} failed {'its' if found.damaged == 1 else 'their'} check and "
                f"{'was' if found.damaged == 1 else 'were'} left out; the rows before and after are there, "
                f"and the stream is kept as {shown(str(found.kept))}"
            )
        for path in found.tables:
            print(_left(path))
        return FINE
    if len(args.file) != 1:
        raise ValueError("audit takes one file, or: audit recover FILE")
    if args.export and not args.by:
        raise ValueError(
            f"--export {args.export} writes one table; say which with --by component, port, junction or event"
        )
    if args.unit and args.percent:
        raise ValueError(
            f"--percent writes energies as parts of the whole, --unit {args.unit} in {args.unit}: leave one of them out"
        )
    window, levels, path = _window(args.window), Alarms(args.alarm, args.alarm_junction), _existing(args.file[0])
    if args.why:
        _require_alone(args)
    summary = summarise(path, args.rtol, window)
    if args.why:
        from phfmu.audit.blame import blame, why

        print("\n".join(f"{i}. {sentence}" for i, sentence in enumerate(why(blame(path)), 1)))
        return FINE if summary.closed else LEDGER
    unit = fitting(summary) if args.unit == "auto" else args.unit or "J"
    scale = shares(summary) if args.percent else Scale(unit)
    events = list(event_rows(str(path), window)) if args.by == "event" else []
    if args.export:
        print(audit_csv(summary, args.by, scale, events), end="")
    else:
        by, most = ([args.by], None) if args.by else ([], None if args.all else ROWS)
        print(audit_table(summary, by=by, scale=scale, events=events, levels=levels, most=most), end="")
    return FINE if summary.closed else LEDGER


def _require_alone(args: argparse.Namespace) -> None:
    """Raise ValueError for options of tables beside --why."""
    given = [f"--{name}" for name in ("window", "by", "unit", "export") if getattr(args, name)]
    given += ["--percent"] if args.percent else []
    if given:
        raise ValueError(f"--why writes sentences about the whole run, no table: leave out {' and '.join(given)}")


def _window(text: str | None) -> Window | None:
    from phfmu.audit.log.window import Window

    if text is None:
        return None
    first, colon, last = text.partition(":")
    try:
        ends = [float(t) if t.strip() else d for t, d in ((first, -inf), (last, inf))]
    except ValueError:
        colon = ""
        ends = []
    if not colon:
        raise ValueError(f"--window {text}: expected A:B in s, e.g. 0.5:1.5, 0.5: or :1.5")
    return Window(*ends)


def _left(path: Path) -> str:
    """The use that an unfinished table is of; `path` is that of its file, its name that of the table and more."""
    if path.name.rsplit(".", 3)[1] == "parquet":
        return f"the table of -o is lost, for Parquet cannot be read without its end; {shown(str(path))} may be deleted"
    return f"the table of -o is in {shown(str(path))}; its last line may be cut off"


def _existing(path: str) -> Path:
    found = Path(path)
    if found.suffix == ".csv":
        raise ValueError(
            f"{path} is the table of a run; its audit is a file besides: phfmu run TARGET --audit X.parquet"
        )
    if not found.is_file() and not found.with_suffix(".arrows").is_file():
        name = path if found.suffix == ".parquet" else f"{path}.audit.parquet"
        raise FileNotFoundError(f"no audit file '{path}'; write one with: phfmu run TARGET --audit {name}")
    return found
