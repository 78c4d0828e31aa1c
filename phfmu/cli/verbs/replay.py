"""phfmu replay: runs again what an audit tells of, and compares both logs bit for bit."""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

#: lines about what differs in the first step that does
LINES = 8


def add_parser(verbs: Any) -> None:
    parser = verbs.add_parser("replay", help="the run of an audit again; exit 1 where a bit of its ledger differs")
    parser.add_argument("audit", help="X.parquet of phfmu run --audit, or X.arrows of a run that did not end")
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.audit.difference import first_differences
    from phfmu.audit.log.archive import metadata, read
    from phfmu.cli.codes import FINE, PROBLEMS
    from phfmu.cli.origin import KEY, SHOWN, changed
    from phfmu.cli.verbs import run
    from phfmu.outcome.status import StepFailure

    was = read(args.audit)
    found = metadata(was).get(KEY)
    if not isinstance(found, dict):
        raise ValueError(
            f"{args.audit} does not tell the options of its run; write it with: phfmu run TARGET --audit FILE"
        )
    with TemporaryDirectory() as folder:
        log = Path(folder) / "replay.parquet"
        again = argparse.Namespace(**_defaults() | found["options"] | SHOWN | {"audit": str(log)})
        others = changed(found, again)
        failure = None
        try:
            run.call(again)
        except StepFailure as error:  # the first run may have ended like this, too: the logs tell
            failure = error
        if failure is not None and not log.exists():
            raise failure
        now = read(log)
    differ = first_differences(was, now)
    for line in others:
        print(f"changed: {line}")
    if not differ:
        print(f"{args.audit}: {was.num_rows} rows, every bit as it was")
        return FINE
    print(f"first difference: {differ[0]}")
    for line in differ[1:LINES]:
        print(f"  also {line}")
    if len(differ) > LINES:
        print(f"  and {len(differ) - LINES} more in the same step")
    if not others:
        print("files, libraries and machine are as they were: a unit is not deterministic, or memory has failed")
    return PROBLEMS


def _defaults() -> dict[str, Any]:
    """Values of options that the version that wrote the audit did not have."""
    from phfmu.cli.verbs import run

    verbs = argparse.ArgumentParser().add_subparsers()
    run.add_parser(verbs)
    return vars(verbs.choices["run"].parse_args(["TARGET"]))
