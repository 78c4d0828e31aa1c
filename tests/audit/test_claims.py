"""What a log claims is held against its rows: numbers that were changed, energies not recorded, rows that are missing."""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet
import pytest

from phfmu.audit import (
    AuditWriter,
    Booking,
    Ledger,
    LedgerSummary,
    analysis,
    read,
    summarise,
    verdict,
)
from tests.audit.arrays import BOOKING, add_blocks, book, run_arrays, write_run

# a file that contradicts itself


def tampered(path: Path, row: str, column: str, change: Callable[[float], float], step: int = 7) -> LedgerSummary:
    """The verdict on a log whose first row of a kind and step says something else."""
    table = read(write_run(path, leak=0.0))
    at = next(i for i, r in enumerate(table.to_pylist()) if (r["row"], r["step"]) == (row, step))
    values = table[column].to_pylist()
    values[at] = change(values[at])
    place = table.column_names.index(column)
    pa.parquet.write_table(table.set_column(place, table.schema.field(column), [values]), path)
    return summarise(path)


@pytest.mark.parametrize(
    ("row", "column", "expected"),
    [
        ("component", "residual", "component a: the row of step 7 says residual"),
        ("component", "H0", "a: H changed by"),
        ("component", "t0", "component a: the row of step 7 says t0"),
        ("component", "supplied", "a: step 7"),
        ("port", "supplied", "bus: step 7"),
        ("junction", "residual", "junction bus: the row of step 7 says residual"),
        ("junction", "exchanged", "junction bus: the row of step 7 says exchanged"),
        ("network", "dH", "network: the row of step 7 says dH"),
        ("network", "external", "network: the row of step 7 says external"),
        ("network", "unexplained", "network: the row of step 7 says unexplained"),
        ("network", "cum_dissipated", "network: the row of step 7 says cum_dissipated"),
        ("network", "H", "network: the row of step 7 says H"),
    ],
)
def test_rows_of_a_file_are_held_against_each_other(tmp_path: Path, row: str, column: str, expected: str):
    assert summarise(write_run(tmp_path / "x.parquet", leak=0.0)).closed
    summary = tampered(tmp_path / "x.parquet", row, column, lambda x: x + 1e-3)
    assert any(str(v).startswith(expected) for v in summary.violations), summary.violations


def test_claims_of_a_file_are_not_believed(tmp_path: Path):
    """A component called estimated, or without books, whose ports are exact is judged all the same."""
    arrays = run_arrays(20, leak=0.0)
    arrays["dissipated"][5, 0] += 1e-3
    for claim in ("estimated", "none"):
        path = tmp_path / f"{claim}.parquet"
        with AuditWriter(path) as sink:
            add_blocks(Ledger(sink), arrays, 20)
        table = read(path)
        component = pa.compute.equal(table["row"].cast("string"), "component")
        quality = pa.compute.if_else(component, claim, table["quality"].cast("string"))
        pa.parquet.write_table(table.set_column(table.column_names.index("quality"), "quality", quality), path)
        found = verdict(path)
        assert {("balance", "a"), ("file", "a")} <= {(v.kind, v.name) for v in found}
        assert any(f"calls its books '{claim}'; by its ports they are 'exact'" in str(v) for v in found)


def inflated(path: Path, arrays: dict[str, np.ndarray], at: Callable[[np.ndarray], np.ndarray], rtol: float) -> Path:
    """A log whose rows of component a say `at` of what moved in it."""
    with AuditWriter(path) as sink:
        add_blocks(Ledger(sink, rtol), arrays, 20)
    table = read(path)
    row, component = (np.array(table[name].cast("string").to_pylist(), object) for name in ("row", "component"))
    own = (row == "component") & (component == "a")
    moved = table["moved"].to_numpy().copy()
    moved[own] = at(moved[own])
    place = table.column_names.index("moved")
    pa.parquet.write_table(table.set_column(place, "moved", pa.array(moved, from_pandas=True)), path)
    return path


@pytest.mark.parametrize("rtol", [1e-11, 1e-6, 1e-13])
@pytest.mark.parametrize(
    "at", [lambda m: np.full_like(m, 1e9), lambda m: np.where(np.arange(len(m)), m, 1e13)], ids=["all", "first"]
)
def test_a_moved_that_was_not_recorded_hides_nothing(
    tmp_path: Path, rtol: float, at: Callable[[np.ndarray], np.ndarray]
):
    """1e9 J in every step, or 1e13 J in the first, whose rounding counts from then on, would allow the 1 mJ that is missing."""
    arrays = run_arrays(20, leak=0.0)
    arrays["moved"] = np.ones((20, 2))
    assert verdict(inflated(tmp_path / "sound.parquet", arrays, np.copy, rtol)) == []
    arrays["dissipated"][5, 0] += 1e-3
    arrays["dissipated"][0], arrays["supplied"][0], arrays["port_energy"][0] = 0.0, 0.0, 0.0
    arrays["dH"][0] = 0.0  # nothing is missing in the first step, whatever moves in it
    arrays["H"] = 10.0 + np.cumsum(arrays["dH"], axis=0)
    assert {("balance", "a")} <= {
        (v.kind, v.name) for v in verdict(inflated(tmp_path / "x.parquet", arrays, np.copy, rtol))
    }
    found = verdict(inflated(tmp_path / "y.parquet", arrays, at, rtol))
    (told,) = [v for v in found if v.kind == "file"]
    assert told.name == "component a" and "says residual_rel" in str(told)


def test_a_moved_that_no_ratio_bears_is_told(tmp_path: Path):
    arrays = run_arrays(20, leak=0.0) | {"moved": np.ones((20, 2))}
    table = read(inflated(tmp_path / "x.parquet", arrays, np.copy, 1e-11))
    (a, b) = verdict(table.drop_columns("residual_rel"))
    assert (
        str(a).startswith("component a: the row of step 0 says moved without residual_rel") and a.steps == b.steps == 20
    )


def test_rows_that_are_missing_are_found(tmp_path: Path):
    table = read(write_run(tmp_path / "x.parquet", leak=0.0))
    rows = table.to_pylist()
    for what, kept, said in (
        ("a step", [r for r in rows if r["step"] != 9], "step 8 is followed by step 10"),
        (
            "a network row",
            [r for r in rows if (r["row"], r["step"]) != ("network", 9)],
            "of step 9, have no network row",
        ),
        (
            "the end",
            [r for r in rows if (r["row"], r["step"]) != ("network", 49)],
            "from step 49 on have no network row",
        ),
        (
            "a junction",
            [r for r in rows if (r["row"], r["step"]) != ("junction", 9)],
            "junctions none; by its ports there are bus",
        ),
        ("a port", [r for r in rows if (r["row"], r["step"], r["index"]) != ("port", 9, 2)], "b: step 9"),
    ):
        found = verdict(pa.Table.from_pylist(kept, table.schema))
        assert any(said in str(v) for v in found), (what, found)


def test_a_log_is_judged_in_bounded_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Four times the steps, the same memory; rows of a step may lie in different row groups."""
    monkeypatch.setattr("phfmu.audit.log.reading.BATCH_ROWS", 1 << 11)
    peak = []
    for n in (1_500, 6_000):
        path = tmp_path / f"{n}.parquet"
        with AuditWriter(path) as sink:
            ledger = Ledger(sink)
            add_blocks(ledger, run_arrays(n, leak=0.0), 1024)
        tracemalloc.start()
        assert summarise(path) == ledger.summary()
        peak.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peak[1] < 1.5 * peak[0]
    pa.parquet.write_table(
        pa.parquet.read_table(tmp_path / "1500.parquet"), tmp_path / "cut.parquet", row_group_size=997
    )
    assert summarise(tmp_path / "cut.parquet") == summarise(tmp_path / "1500.parquet")


def test_a_log_that_unpacks_to_too_much_is_refused_before_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Some kB of zeros that would become 2 MB of one column."""
    write_run(tmp_path / "x.parquet")
    schema = read(tmp_path / "x.parquet").schema
    n = 1 << 18
    columns = {"row": pa.array(["network"] * n), "dH": pa.array(np.zeros(n))}
    table = pa.table(columns).replace_schema_metadata(schema.metadata)
    pa.parquet.write_table(table, tmp_path / "bomb.parquet", compression="zstd", use_dictionary=False)
    assert (tmp_path / "bomb.parquet").stat().st_size < 20_000
    monkeypatch.setattr("phfmu.audit.log.reading.COLUMN_BYTES", 1 << 20)
    with pytest.raises(
        ValueError, match=r"row group 0 unpacks its column 'row' from \d+ to \d+ bytes; at most 1048576"
    ):
        summarise(tmp_path / "bomb.parquet")


def test_steps_of_ports_without_an_index_are_booked_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The column of indices is empty where no port is a vector: steps of one booking stay one run."""
    booking = Booking(BOOKING.components, tuple(replace(p, port=f"p{p.index or 0}", index=None) for p in BOOKING.ports))
    with AuditWriter(tmp_path / "x.parquet") as sink:
        book(Ledger(sink), booking, **run_arrays(50))
    runs, booked = [], analysis._BlockReader._book_run

    def counted(self: analysis._BlockReader, grouped: Any, a: int, b: int) -> None:
        runs.append(b - a)
        booked(self, grouped, a, b)

    monkeypatch.setattr(analysis._BlockReader, "_book_run", counted)
    assert summarise(tmp_path / "x.parquet").steps == 50
    assert runs == [50]
