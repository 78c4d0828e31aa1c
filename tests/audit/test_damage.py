"""Damaged logs: what can be kept is kept, nothing is removed before that stands, and nothing damaged reaches Arrow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow import compute

from phfmu.audit import AuditWriter, Ledger, read, recover, summarise
from phfmu.audit.log.archive import Stream
from phfmu.audit.log.blocks import StreamBlocks
from phfmu.audit.log.seal import _MARK
from phfmu.audit.violation import ViolationKind
from phfmu.cli import main
from tests.audit.arrays import BOOKING, book, run_arrays, write_run

BLOCKS, ROWS = 8, 41  # of 5 steps each and an event, after the header


@pytest.fixture
def stream(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The stream of a run that is killed: new names come in every block."""
    monkeypatch.setattr("phfmu.audit.log.stream.FLUSH_SECONDS", 60.0)  # blocks end where this ends them
    path = tmp_path / "whole.arrows"
    writer = AuditWriter(path.with_suffix(".parquet"), {"target": "two"})
    ledger, arrays = Ledger(writer), run_arrays(5 * BLOCKS)
    for k in range(BLOCKS):
        booking = replace(BOOKING, components=("a", f"b{k}"))
        book(ledger, booking, **{name: x[5 * k : 5 * k + 5] for name, x in arrays.items()})
        ledger.event(1.0 + k, "input", message=f"after block {k}")
        ledger.flush()
    writer._release()
    return path


def flipped(data: bytes, at: int, bit: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :]


def rows_of(table: pa.Table) -> list[tuple]:
    """All rows, whatever columns are empty."""
    names = ("row", "step", "t0", "component", "port", "index", "junction", "H0", "supplied", "kind", "message")
    return list(
        zip(*(table[n].to_pylist() if n in table.column_names else [None] * table.num_rows for n in names), strict=True)
    )


@pytest.mark.parametrize("stride", [1499, pytest.param(113, marks=pytest.mark.slow)])
def test_one_flipped_bit_costs_one_block_at_most(stream: Path, stride: int) -> None:
    """Before and after it every row is there, with its names; the stream stays where something failed."""
    data, whole = stream.read_bytes(), rows_of(read(stream))
    found = StreamBlocks(data).blocks
    assert [b.number for b in found] == list(range(BLOCKS + 1)) and len(whole) == BLOCKS * ROWS
    counts = {"flips": 0, "unharmed": 0, "lost a block": 0, "lost the header": 0}
    for i, at in enumerate(range(0, len(data), stride)):
        counts["flips"] += 1
        torn = stream.with_name("torn.arrows")
        torn.write_bytes(flipped(data, at, i % 8))
        hit = next((b.number for b in found if b.start <= at < b.end), None)
        done = recover(torn)
        lost = 0 if hit is None else (ROWS if hit else 0)
        kept = whole if not lost else whole[: (hit - 1) * ROWS] + whole[hit * ROWS :]  # pyright: ignore[reportOptionalOperand]
        assert (done.rows, rows_of(read(done.path))) == (len(kept), kept), (at, hit)
        last = hit == BLOCKS and not done.damaged  # its mark is hit: it looks like one that was never finished
        assert done.damaged == (hit is not None and not last) and done.torn == last
        assert (done.kept is not None) == bool(done.damaged) and torn.exists() is False
        if done.kept is not None:
            assert done.kept.read_bytes() == flipped(data, at, i % 8)
        assert ("target" in str(read(done.path).schema.metadata)) == (hit != 0)
        counts["unharmed" if hit is None else "lost a block" if hit else "lost the header"] += 1
    assert counts["flips"] == sum(list(counts.values())[1:]) > 10
    assert counts["lost a block"] > 8


def test_two_blocks_in_a_row_take_the_names_that_only_they_told(stream: Path) -> None:
    data = bytearray(stream.read_bytes())
    for block in StreamBlocks(bytes(data)).blocks[3:5]:
        data[block.end - 40] ^= 16
    stream.write_bytes(data)
    done = recover(stream)
    names = {n for n in read(done.path)["component"].to_pylist() if n}
    assert done.damaged == 2 and done.rows == (BLOCKS - 2) * ROWS
    assert names == {"a", "b", "b0", "b1", "b4", "b5", "b6", "b7"}


def test_blocks_lost_in_a_row_leave_codes_that_are_told(stream: Path) -> None:
    data = bytearray(stream.read_bytes())
    for block in StreamBlocks(bytes(data)).blocks[1:4]:
        data[block.end - 40] ^= 16
    stream.write_bytes(data)
    table = read(stream)
    assert any(n.endswith("is lost") for n in table["component"].to_pylist() if n)
    assert Stream(stream).damaged == 3


def test_a_log_with_a_hole_is_not_closed_and_the_command_says_what_was_kept(
    stream: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = stream.read_bytes()
    hole = StreamBlocks(data).blocks[4]
    stream.write_bytes(flipped(data, hole.start + 2000, 3))
    assert main(["audit", "recover", str(stream)]) == 0
    told = capsys.readouterr().out
    assert "1 batch failed their check" not in told and "1 batch failed its check" in told
    assert "whole.arrows.damaged" in told and stream.with_name("whole.arrows.damaged").exists()
    assert main(["audit", str(stream.with_suffix(".parquet"))]) == 4
    assert "is followed by step" in capsys.readouterr().out


@pytest.mark.parametrize("stride", [509, pytest.param(37, marks=pytest.mark.slow)])
def test_a_damaged_archive_is_refused_before_it_is_read(tmp_path: Path, stride: int) -> None:
    path = write_run(tmp_path / "x.parquet")
    data, bad = path.read_bytes(), tmp_path / "bad.parquet"
    harmless = 0
    for i, at in enumerate(range(0, len(data), stride)):
        bad.write_bytes(flipped(data, at, i % 8))
        try:
            harmless += read(bad).equals(read(path))
        except ValueError as error:
            assert "is damaged" in str(error)
            continue
        assert not _MARK.search(bad.read_bytes()), at  # the mark itself was hit, and nothing else
    assert harmless <= 2


def cut(path: Path, steps: int) -> Path:
    """The first steps of an archive, written by another tool with the metadata of the whole."""
    part = path.with_name("cut.parquet")
    pq.write_table(read(path).filter(compute.field("step") < steps), part)
    return part


def test_an_archive_with_its_last_half_cut_off_is_not_closed(tmp_path: Path) -> None:
    path = write_run(tmp_path / "x.parquet", leak=0.0)
    assert summarise(path).closed and summarise(cut(path, 50)).closed
    found = summarise(cut(path, 25))
    assert [v.kind for v in found.violations] == [ViolationKind.FILE]
    assert "the footer: it says that the log holds 50 steps to t = 1.5 s; there are 25 steps to t = 1.25 s" in str(
        found.violations[0]
    )


def test_a_file_that_ends_in_the_middle_is_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_run(tmp_path / "x.parquet")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert main(["audit", str(path)]) == 2
    assert "x.parquet is not an audit log" in capsys.readouterr().err


def test_a_stream_that_does_not_hold_what_was_written_is_not_removed(tmp_path: Path) -> None:
    """Another process overwrites some of it while the run goes on."""
    path = tmp_path / "x.parquet"
    writer = AuditWriter(path)
    ledger, arrays = Ledger(writer), run_arrays(20)
    book(ledger, BOOKING, **arrays)
    ledger.flush()
    with open(writer.stream, "r+b") as file:
        file.seek(-3000, 2)
        file.write(bytes(8))
    with pytest.raises(OSError, match=r"the stream holds 0 of \d+ rows.*recover"):
        writer.close()
    assert writer.stream.exists() and not path.exists()


def test_a_stream_is_read_as_any_arrow_reader_reads_it(stream: Path) -> None:
    """Names are decoded from the marks here, from the dictionaries of the stream there."""
    with pa.ipc.open_stream(stream.read_bytes()) as reader:
        whole = rows_of(reader.read_all())
    table, again = read(stream), read(recover(stream).path)
    assert rows_of(table) == whole
    assert rows_of(table) == rows_of(again)
    assert np.array_equal(table["H0"].to_numpy(), again["H0"].to_numpy(), equal_nan=True)
