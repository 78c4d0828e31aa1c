"""Kinds in the audit are typed values, which files and printed tables say as they always have."""

import csv
import io
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from phfmu.audit import Booking, Ledger, PortKey, read, summarise
from phfmu.audit.kinds import ColumnType, LedgerVerdict, Quality, RowKind
from phfmu.audit.log.columns import COLUMNS, FIELDS
from phfmu.audit.log.stream import AuditWriter
from phfmu.audit.tables.report import audit_csv
from phfmu.audit.tables.sheet_names import KINDS
from phfmu.audit.tables.sheets import all_sheets
from phfmu.audit.violation import ViolationKind
from phfmu.outcome.steps import Steps


def booked(path: Path) -> Ledger:
    """One exact component that misses 1 J beside an estimated one."""
    ports = (PortKey("a", "p", junction="j"), PortKey("b", "p", junction="j", quality=Quality.ESTIMATED))
    with AuditWriter(path) as log:
        ledger = Ledger(log)
        one = np.ones((1, 2))
        steps = Steps(H=one, stored=np.array([[2.0, 1.0]]), dissipated=0 * one, supplied=one, pairs=one)
        ledger.add(Booking(("a", "b"), ports), 0, 0.0, 0.1, steps)
        ledger.event(0.1, "input", message="u = 1")
    return ledger


def test_kinds_are_typed_and_written_as_words(tmp_path: Path) -> None:
    summary = booked(tmp_path / "a.parquet").summary()
    for s in (summary, summarise(tmp_path / "a.parquet")):
        assert [c.verdict for c in s.components] == [LedgerVerdict.VIOLATED, LedgerVerdict.ESTIMATED]
        assert all(type(c.verdict) is LedgerVerdict for c in s.components)
        assert all(type(p.quality) is Quality for p in s.ports)
        assert {v.kind for v in s.violations} >= {ViolationKind.BALANCE}
        assert all(type(v.kind) is ViolationKind for v in s.violations)
    assert all(type(kind) is ColumnType for kind in COLUMNS.values()) and all(type(kind) is RowKind for kind in FIELDS)
    table = read(tmp_path / "a.parquet")
    assert set(table["row"].to_pylist()) == {"component", "port", "junction", "network", "event"}
    assert set(table["quality"].to_pylist()) == {"exact", "estimated", None}
    assert str(pq.read_schema(tmp_path / "a.parquet").field("row").type).startswith("dictionary<values=string")
    assert {s.title for s in all_sheets(summary)} == set(RowKind) - {RowKind.HASH}
    cells = list(csv.reader(io.StringIO(audit_csv(summary, "component"))))
    assert [row[-1] for row in cells] == ["verdict", "VIOLATED", "estimated"]


def test_choices_of_the_command_line_are_plain_words() -> None:
    """argparse shows what it refuses by repr."""
    assert [repr(k) for k in KINDS] == [f"'{k}'" for k in ("component", "port", "junction", "part", "term", "event")]
