"""The log of a run: what it holds, readable while it is written, whole up to a kill."""

import math
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet
import pytest

from phfmu import audit
from phfmu.audit import (
    AuditWriter,
    Booking,
    Ledger,
    PortKey,
    audit_table,
    read,
    recover,
    summarise,
    verdict,
)
from tests.audit.arrays import BOOKING, add_blocks, book, run_arrays

# the log


def test_log_holds_metadata_and_only_used_columns(tmp_path: Path):
    path = tmp_path / "run.audit.parquet"
    with AuditWriter(path, {"units": {"a.p": ["V", "A"]}, "model": "sha256:00"}) as sink:
        assert sink.stream == tmp_path / "run.audit.arrows"
        assert sink.stream.exists()
        book(Ledger(sink), Booking(("a",)), step=[0, 1], t0=[0.0, 0.1], h=0.1, H=[[1.0], [1.0]], dH=[[0.0], [0.0]])
    assert os.listdir(tmp_path) == ["run.audit.parquet"]
    table = read(path)
    assert set(table.column_names) == {
        *(
            "row",
            "step",
            "t0",
            "h",
            "component",
            "H",
            "H0",
            "H1",
            "dH",
            "residual",
            "residual_rel",
            "quality",
        ),
        *("dissipated", "supplied", "cum_dissipated", "unexplained", "cum_unexplained"),
    }
    meta = audit.metadata(table)
    assert meta["units"] == {"a.p": ["V", "A"]}
    assert meta["model"] == "sha256:00"
    assert meta["phfmu.audit.schema"] == 1
    assert {"python", "numpy", "pyarrow"} <= set(meta["phfmu.audit.versions"])


def test_values_survive_to_the_last_bit(tmp_path: Path):
    booking = Booking(("a",), (PortKey("a", "p", 2, "bus", "estimated"),))
    columns = {"dissipated": 5e-324, "supplied": -0.1, "numerical": 1 / 3, "moved": 7.0}
    with AuditWriter(tmp_path / "x.parquet") as sink:
        book(
            Ledger(sink), booking, step=[7], t0=[0.7], h=0.1, H0=[[math.pi]], H=[[-math.e]], dH=[[1e-300]],
            port_energy=[[0.1]], **{k: [[v]] for k, v in columns.items()}, iterations=[40000], accepted_by=["energy"],
        )  # fmt: skip
    rows = {r["row"]: r for r in read(tmp_path / "x.parquet").to_pylist()}
    component = columns | {"H0": math.pi, "H1": -math.e, "dH": 1e-300, "quality": "estimated"}  # by its port
    port = {"component": "a", "port": "p", "supplied": 0.1, "index": 2, "junction": "bus", "quality": "estimated"}
    for kind, expected in {
        "component": component,
        "port": port,
        "junction": {"junction": "bus", "residual": 0.1},
        "network": {"iterations": 40000, "accepted_by": "energy", "component": None, "numerical": 1 / 3},
    }.items():
        assert {name: rows[kind][name] for name in expected} == expected


def test_stream_is_readable_while_it_is_written_and_flushed_in_time(tmp_path: Path):
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        add_blocks(ledger, run_arrays(20), 1)
        ledger.flush()
        assert read(sink.stream).num_rows == 20 * 8
        arrays = run_arrays(320)
        add_blocks(ledger, {name: x[20:] for name, x in arrays.items()}, 1)
        assert read(sink.stream).num_rows >= 20 * 8 + 1024
        assert summarise(read(sink.stream)).steps > 20
        with pytest.raises(FileNotFoundError, match="still writing it; what is complete so far: `phfmu audit "):
            read(sink.path)
    with pytest.raises(ValueError, match="closed"):
        sink.flush()
    assert sink.close() == sink.path


def test_log_survives_an_exception(tmp_path: Path):
    with pytest.raises(RuntimeError), AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        add_blocks(ledger, run_arrays(3), 1)
        ledger.event(1.03, "nonconverged", message="step 3: 12 iterations")
        raise RuntimeError
    events = [r for r in read(tmp_path / "x.parquet").to_pylist() if r["row"] == "event"]
    assert events[0]["message"] == "step 3: 12 iterations"
    assert (events[0]["t0"], events[0]["step"]) == (1.03, None)


def test_empty_run(tmp_path: Path):
    with AuditWriter(tmp_path / "x.parquet", {"model": "none"}) as sink:
        ledger = Ledger(sink)
        book(ledger, BOOKING, **run_arrays(0))
    table = read(tmp_path / "x.parquet")
    assert (table.num_rows, table.column_names) == (0, ["row"])
    assert audit.metadata(table)["model"] == "none"
    assert verdict(table) == []
    assert "no steps" in audit_table(table)
    assert audit_table(table) == audit_table(ledger.summary())


@pytest.mark.parametrize("stride", [709, pytest.param(97, marks=pytest.mark.slow)])
def test_torn_stream_gives_back_every_complete_batch(tmp_path: Path, stride: int, monkeypatch: pytest.MonkeyPatch):
    """Cut at many bytes: the recovered rows are always a prefix, never fewer for a later cut."""
    monkeypatch.setattr("phfmu.audit.log.stream.FLUSH_SECONDS", 60.0)  # batches end where this test ends them
    stream = tmp_path / "whole.audit.arrows"
    with AuditWriter(stream.with_suffix(".parquet")) as sink:
        ledger = Ledger(sink)
        arrays = run_arrays(40)
        sizes = []
        for k in range(0, 40, 10):
            # new names appear in later batches, so dictionaries grow within the stream
            booking = replace(BOOKING, components=("a", f"b{k}"))
            book(ledger, booking, **{name: x[k : k + 10] for name, x in arrays.items()})
            ledger.event(1.0 + k, "input", message=f"after step {k}")
            ledger.flush()
            sizes.append(stream.stat().st_size)
        data = stream.read_bytes()
        whole = read(stream)
    assert whole.num_rows == 4 * (80 + 1)
    complete, seen = 0, 0
    cuts = sorted({*range(0, len(data), stride), *sizes, *(s - 1 for s in sizes), len(data)})
    for cut in cuts:
        torn = tmp_path / "torn.audit.arrows"
        torn.write_bytes(data[:cut])
        try:
            recovered = recover(torn)
        except ValueError as error:
            assert "cut off in its header" in str(error)
            assert cut < sizes[0]
            continue
        complete = sum(cut >= size for size in sizes)
        assert recovered.rows == complete * 81
        assert not torn.exists()
        table = read(recovered.path)
        head = whole.slice(0, table.num_rows)
        for column in table.column_names:
            assert table[column].to_pylist() == head[column].to_pylist()
        seen += 1
    assert complete == 4
    assert seen > 50


def test_recover_says_what_is_wrong(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match="ended well"):
        recover(tmp_path / "x.parquet")
    with pytest.raises(ValueError, match="must end in .parquet"):
        AuditWriter(tmp_path / "run.csv")
    (tmp_path / "x.arrows").write_bytes(b"")
    with pytest.raises(FileExistsError, match="recover"):
        AuditWriter(tmp_path / "x.parquet")
    (tmp_path / "y.parquet").write_bytes(b"time,x\n0,1\n")
    with pytest.raises(ValueError, match="not an audit log"):
        read(tmp_path / "y.parquet")
    pa.parquet.write_table(pa.table({"row": ["component"]}), tmp_path / "z.parquet")
    with pytest.raises(ValueError, match="lacks the key"):
        read(tmp_path / "z.parquet")


WRITER = """
import sys
import numpy as np
from phfmu.audit import AuditWriter, Booking, Ledger
from phfmu.outcome.steps import Steps
ledger, k, none = Ledger(AuditWriter(sys.argv[1])), 0, np.zeros((1, 1))
while True:
    ledger.add(Booking(("a",)), [k], [0.1 * k], 0.1, Steps(none + 1.0, none, none, none, np.zeros((1, 0))))
    k += 1
    if k == 800:
        print("ready", flush=True)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_kill_9_loses_at_most_the_last_batch(tmp_path: Path):
    path = tmp_path / "run.audit.parquet"
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True)
    try:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "ready\n"
    finally:
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        writer.stdout.close()  # type: ignore[union-attr]
    assert not path.exists()
    recovered = recover(path)
    table = read(path)
    assert recovered.rows == table.num_rows >= 2 * 800 - 1024
    steps = summarise(table).steps
    assert [r["step"] for r in table.to_pylist() if r["row"] == "network"] == list(range(steps))
