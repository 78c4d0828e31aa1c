"""The energy ledger: closure, the crash-safe log, the verdict."""

import math
import os
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phfmu import audit
from phfmu.audit import (
    AuditWriter,
    Booking,
    Ledger,
    LedgerSummary,
    PortKey,
    analysis,
    audit_table,
    book_steps,
    read,
    recover,
    summarise,
    verdict,
)
from phfmu.audit.sums import CompensatedSum
from phfmu.engine.steps import Steps, balance

# two members on a bus that leaks a little; b's port there has two pairs, and b has a port to the outside
BOOKING = Booking(
    ("a", "b"),
    (
        PortKey("a", "p", junction="bus"),
        PortKey("b", "p", index=1, junction="bus"),
        PortKey("b", "p", index=2, junction="bus"),
        PortKey("b", "field"),
    ),
)


def run_arrays(n: int, seed: int = 0, leak: float = 1e-3) -> dict[str, np.ndarray]:
    """n steps whose components close to rounding while the bus creates energy."""
    rng = np.random.default_rng(seed)
    u, y, h = rng.normal(size=(n, 4)), rng.normal(size=(n, 4)), 0.01
    energy = h * u * y
    energy[:, 0] = -(energy[:, 1] + energy[:, 2]) + leak * rng.normal(size=n)
    supplied = np.stack([energy[:, 0], energy[:, 1] + energy[:, 2] + energy[:, 3]], axis=1)
    dissipated = 0.01 * rng.random((n, 2))
    dH = supplied - dissipated
    H = 10.0 + np.cumsum(dH, axis=0)
    steps = np.arange(n)
    return {
        "step": steps,
        "t0": 1.0 + h * steps,
        "h": np.full(n, h),
        "H": H,
        "dH": dH,
        "dissipated": dissipated,
        "supplied": supplied,
        "port_energy": energy,
    }


def book(ledger: Ledger, booking: Booking, *, step, t0, h, H, dH, H0=None, **columns) -> None:
    """Steps of a ledger; what a run does not have is zero."""
    H = np.array(H, float)
    none = np.zeros_like(H)
    pairs = columns.pop("port_energy", np.zeros((len(H), len(booking.ports))))
    columns = {"dissipated": none, "supplied": none} | columns
    steps = Steps(H, np.asarray(dH), pairs=np.asarray(pairs), **{k: np.asarray(v) for k, v in columns.items()})
    ledger.add(booking, step, t0, h, steps, H0)


def add_blocks(ledger: Ledger, a: dict[str, np.ndarray], size: int) -> None:
    for start in range(0, len(a["step"]), size):
        book(ledger, BOOKING, **{name: x[start : start + size] for name, x in a.items()})


def write_run(path: Path, n: int = 50, size: int = 7, leak: float = 1e-3) -> Path:
    with AuditWriter(path) as sink:
        add_blocks(Ledger(sink), run_arrays(n, leak=leak), size)
    return path


# closure


def test_books_close_by_the_sign_rule():
    """Exact in binary: residuals, junction, external supply and unexplained follow the definitions."""
    ledger = Ledger()
    booking = Booking(
        ("a", "b"), (PortKey("a", "p", junction="bus"), PortKey("b", "p", junction="bus"), PortKey("b", "field"))
    )
    pairs = np.array([[0.75, -0.5, -0.375]])
    steps = Steps(
        H=np.array([[1.5, 1.0]]), stored=np.array([[0.5, -1.0]]), dissipated=np.array([[0.25, 0.0]]),
        supplied=np.array([[0.75, -0.875]]), pairs=pairs,
    )  # fmt: skip
    block = book_steps(booking, [0], [0.0], 1.0, steps)
    assert block.residual.tolist() == [[0.0, -0.125]]
    assert block.H0.tolist() == [[1.0, 2.0]]
    network = {name: column[0] for name, column in block.network.items()}
    assert (network["H"], network["dH"], network["dissipated"]) == (2.5, -0.5, 0.25)
    assert (network["external"], network["junction_residual"]) == (-0.375, 0.25)
    assert network["unexplained"] == block.residual.sum()
    ledger.add(booking, [0], [0.0], 1.0, steps)
    summary = ledger.summary()
    # in play in b: |H0| = 2, for want of its energies' changes, what it was supplied with, and its ports
    assert summary.components[1].worst_relative == pytest.approx(0.125 / (2.0 + 0.875 + 0.875), rel=0.05)
    (bus,) = summary.junctions
    assert (bus.residual, bus.exchanged) == (0.25, 0.625)
    assert summary.components[1].worst_residual == -0.125


def test_closes_for_a_coupling_that_creates_energy_without_bound():
    """A diverging coupling: the junction shows every joule, nothing is unexplained until numbers overflow."""
    ledger, energy = Ledger(), 1.0
    booking = Booking(("a",), (PortKey("a", "p", junction="bus"),))
    for k in range(300):
        gain = [[3.0 * energy]]
        book(
            ledger, booking, step=[k], t0=[0.1 * k], h=0.1, H=[[4.0 * energy]], dH=gain, supplied=gain, port_energy=gain
        )
        energy *= 4.0
    summary = ledger.summary()
    assert summary.network is not None
    assert summary.network.unexplained == 0.0
    assert summary.junctions[0].residual == pytest.approx(energy - 1.0, rel=1e-15)


def test_member_without_energies_lies_outside_the_balance():
    """A foreign unit reports ports only; what it takes from the junction leaves through `external`."""
    booking = Booking(
        ("own",),
        (
            PortKey("own", "p", junction="link"),
            PortKey("foreign", "p", junction="link", quality="estimated"),
            PortKey("foreign", "shaft"),
        ),
    )
    own, none = np.array([[-1.0]]), np.zeros((1, 1))
    block = book_steps(
        booking, [0], [0.0], 0.1, Steps(np.array([[4.0]]), own, none, own, np.array([[-1.0, 0.75, 9.0]]))
    )
    assert block.network["junction_residual"][0] == -0.25
    assert block.network["external"][0] == -0.75
    assert block.network["unexplained"][0] == 0.0


def test_what_a_damping_scheme_loses_is_in_the_balance():
    """One formula for floats and columns, for a step and for the network."""
    assert balance(-3.0, 1.0, -1.5, 0.5) == 0.0
    lost = Steps(
        *(np.array([[x]]) for x in (5.0, -3.0, 1.0, -1.5)), pairs=np.array([[-1.5]]), numerical=np.array([[0.5]])
    )
    block = book_steps(Booking(("a",), (PortKey("a", "p"),)), [0], [0.0], 0.1, lost)
    assert block.residual[0, 0] == block.network["unexplained"][0] == 0.0
    assert book_steps(block.booking, [0], [0.0], 0.1, replace(lost, numerical=None)).residual[0, 0] == -0.5


@given(st.lists(st.floats(-1e12, 1e12), min_size=1, max_size=200), st.integers(1, 50))
@settings(max_examples=60, deadline=None)
def test_sums_are_compensated_and_do_not_depend_on_the_cut(values: list[float], size: int):
    one, many = CompensatedSum(), CompensatedSum()
    last = [one.add(x) for x in values][-1]
    running = np.concatenate([many.extend(np.array(values[k : k + size])) for k in range(0, len(values), size)])
    assert (many.high, many.low) == (one.high, one.low)
    assert running[-1] == last
    exact = float(sum(map(Fraction, values)))
    # second order: n^2 eps^2 sum |x|
    assert abs(last - exact) <= 2**-52 * abs(exact) + (len(values) * 2**-52) ** 2 * sum(map(abs, values))


def test_blocks_of_any_size_are_equal_bit_for_bit(tmp_path: Path):
    arrays = run_arrays(200)
    summaries, tables = [], []
    for size in (1, 33, 200):
        with AuditWriter(tmp_path / f"{size}.audit.parquet") as sink:
            ledger = Ledger(sink)
            add_blocks(ledger, arrays, size)
        summaries.append(ledger.summary())
        order = [(key, "ascending") for key in ("row", "step", "component", "port", "index")]
        table = read(tmp_path / f"{size}.audit.parquet")
        for i, column in enumerate(table.column_names):
            if pa.types.is_dictionary(table.schema.field(column).type):
                table = table.set_column(i, column, table[column].cast("string"))
        tables.append(table.sort_by(order))
    assert summaries[0] == summaries[1] == summaries[2]
    assert summaries[0].network is not None
    assert summaries[0].network.worst_unexplained < 1e-15
    assert abs(summaries[0].network.junction_residual or 0.0) > 1e-4
    assert tables[0].equals(tables[1])
    assert tables[0].equals(tables[2])


def test_summary_of_the_file_equals_the_running_one(tmp_path: Path):
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        add_blocks(ledger, run_arrays(120), 50)
        ledger.event(2.2, "reprojection", "a", energy_jump=-1 / 3, message="gap 1e-3 closed")
    running, stored = ledger.summary(), summarise(read(tmp_path / "x.parquet"))
    assert stored == running
    assert stored.components[0].jumps == -1 / 3


def test_block_arrays_may_be_reused_by_the_caller(tmp_path: Path):
    arrays = run_arrays(10, leak=0.0)
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        book(ledger, BOOKING, **arrays)
        for array in arrays.values():
            array[...] = 0
    assert verdict(read(tmp_path / "x.parquet")) == []
    assert summarise(read(tmp_path / "x.parquet")) == ledger.summary()


def test_block_of_a_wrong_shape_is_refused_with_both_shapes():
    arrays = run_arrays(5)
    arrays["supplied"] = arrays["supplied"][:, :1]
    with pytest.raises(ValueError, match=r"supplied has shape \(5, 1\), expected \(5, 2\)"):
        book(Ledger(), BOOKING, **arrays)
    two = np.zeros((1, 2))
    with pytest.raises(ValueError, match=r"pairs has shape \(1, 2\), expected \(1, 4\)"):
        Ledger().add(BOOKING, [0], [0.0], 1.0, Steps(two, two, two, two, two))


def test_blocks_are_cheap(tmp_path: Path):
    """Thousands of steps between reports must not cost what stepping them costs: 50 us a step at most."""
    arrays = run_arrays(20000)
    with AuditWriter(tmp_path / "x.parquet") as sink:
        start = time.process_time()
        add_blocks(Ledger(sink), arrays, 5000)
        assert time.process_time() - start < 20000 * 50e-6


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


@pytest.mark.parametrize("stride", [797, pytest.param(97, marks=pytest.mark.slow)])
def test_torn_stream_gives_back_every_complete_batch(tmp_path: Path, stride: int, monkeypatch: pytest.MonkeyPatch):
    """Cut at many bytes: the recovered rows are always a prefix, never fewer for a later cut."""
    monkeypatch.setattr("phfmu.audit.stream.FLUSH_SECONDS", 60.0)  # batches end where this test ends them
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
from phfmu.engine.steps import Steps
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


# the verdict


def judged(arrays: dict[str, np.ndarray], path: Path | None = None, rtol: float = 1e-11) -> LedgerSummary:
    """The summary of a run; with a path, also that of its file is asked for and must be the same."""
    if path is None:
        ledger = Ledger(rtol=rtol)
        add_blocks(ledger, arrays, 30)
        return ledger.summary()
    with AuditWriter(path) as sink:
        ledger = Ledger(sink, rtol)
        add_blocks(ledger, arrays, 30)
    live, stored = ledger.summary(), summarise(path, rtol)
    assert str(live) == str(stored)  # NaN has no equal
    return stored


def kinds(summary: LedgerSummary) -> set[tuple[str, str]]:
    return {(v.kind, v.name) for v in summary.violations}


def test_verdict_finds_the_step_that_does_not_close(tmp_path: Path):
    arrays = run_arrays(100, leak=0.0)
    arrays["dissipated"][41, 1] += 1e-6
    summary = judged(arrays, tmp_path / "x.parquet")
    assert kinds(summary) == {("balance", "b"), ("unexplained", "network")}
    violation = summary.violations[0]
    assert (violation.step, violation.t0, violation.steps) == (41, pytest.approx(1.41), 1)
    assert violation.size == pytest.approx(1e-6, rel=1e-6)
    assert 1e-11 * 5 < violation.allowed < 1e-11 * 30  # |H| is 10 J, ports pass some J
    table = read(tmp_path / "x.parquet")
    assert verdict(table) == verdict(tmp_path / "x.parquet") == summary.violations
    assert verdict(table, rtol=1e-5) == []
    text = audit_table(table)
    assert "b: step 41 at t = 1.41 s misses 1.000e-06 J" in text
    assert "VIOLATED" in text
    assert "VIOLATED" not in audit_table(table, rtol=1e-5)


def test_dissipation_is_not_negative(tmp_path: Path):
    """A resistance that creates 1 mJ closes the balance: the loss is what it is booked as."""
    arrays = run_arrays(100, leak=0.0)
    arrays["dH"][41, 1] += arrays["dissipated"][41, 1] + 1e-3
    arrays["dissipated"][41, 1] = -1e-3
    arrays["H"] = 10.0 + np.cumsum(arrays["dH"], axis=0)
    summary = judged(arrays, tmp_path / "x.parquet")
    assert kinds(summary) == {("dissipation", "b")}
    assert (summary.violations[0].step, summary.violations[0].size) == (41, -1e-3)
    assert [c.verdict for c in summary.components] == ["closed", "VIOLATED"]
    assert "b: step 41 at t = 1.41 s dissipates -1.000e-03 J" in audit_table(summary)
    arrays["dissipated"][41, 1] = -1e-14  # rounding
    arrays["dH"][41, 1] -= 1e-3
    arrays["H"] = 10.0 + np.cumsum(arrays["dH"], axis=0)
    assert judged(arrays).closed


def test_ports_and_books_must_agree(tmp_path: Path):
    """A unit whose ports say twice what its books say."""
    arrays = run_arrays(50, leak=0.0)
    arrays["port_energy"][7, 3] += 2.93  # b.field, at no junction
    summary = judged(arrays, tmp_path / "x.parquet")
    assert kinds(summary) == {("ports", "b"), ("unexplained", "network")}
    assert summary.violations[0].size == pytest.approx(-2.93, rel=1e-9)
    assert summary.network is not None
    assert (summary.components[1].verdict, summary.network.verdict) == ("VIOLATED", "VIOLATED")


def test_a_junction_that_creates_energy_violates(tmp_path: Path):
    summary = judged(run_arrays(50, leak=1e-3), tmp_path / "x.parquet")
    assert kinds(summary) == {("junction", "bus")}
    assert summary.junctions[0].verdict == "VIOLATED"
    assert "bus: step" in audit_table(summary)


@pytest.mark.parametrize("offset", [0.0, 1e10])
def test_a_constant_in_H_hides_nothing(tmp_path: Path, offset: float):
    """19 J made in 1000 steps beside an energy of 1e10 J that stays."""
    arrays = run_arrays(1000, leak=0.0)
    arrays["moved"] = np.abs(arrays["dH"])
    arrays["H"] = arrays["H"] + offset
    arrays["H0"] = np.vstack([[10.0 + offset, 10.0 + offset], arrays["H"][:-1]])
    assert judged(arrays, tmp_path / "x.parquet").closed
    arrays["dH"][:, 0] += 0.019
    arrays["H"][:, 0] += 0.019 * np.arange(1, 1001)
    arrays["H0"][1:] = arrays["H"][:-1]
    summary = judged(arrays, tmp_path / "y.parquet")
    assert kinds(summary) == {("balance", "a"), ("unexplained", "network")}
    assert summary.violations[0].steps == 1000


def test_coming_to_rest_is_not_a_violation(tmp_path: Path):
    """Energies fade to 1e-30 J while residuals stay at the rounding of those that were: eps times 10 J."""
    n = 2000
    energy = 10.0 * np.exp(-0.04 * np.arange(n + 1))
    lost = -np.diff(energy) + 1e-15 * np.random.default_rng(1).uniform(-1, 1, n)
    arrays = {"step": np.arange(n), "t0": 0.01 * np.arange(n), "h": np.full(n, 0.01), "H": energy[1:, None]}
    arrays |= {"dH": np.diff(energy)[:, None], "dissipated": lost[:, None], "moved": -np.diff(energy)[:, None]}
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        book(ledger, Booking(("pendulum",)), **arrays)
    assert ledger.summary().closed
    assert ledger.summary() == summarise(tmp_path / "x.parquet")
    arrays["dissipated"][1500] += 1e-11
    broken = Ledger()
    book(broken, Booking(("pendulum",)), **arrays)
    assert [v.step for v in broken.summary().violations if v.kind == "balance"] == [1500]


def test_H_that_changes_without_being_booked_is_found(tmp_path: Path):
    """Between two steps, within one, and slowly beside a constant that hides a single step."""
    jump = run_arrays(100, leak=0.0)
    jump["H"][60:, 0] += 0.5
    jump["H0"] = np.vstack([[10.0, 10.0], jump["H"][:-1]])
    jump["H0"][60, 0] += 0.5
    summary = judged(jump, tmp_path / "jump.parquet")
    assert kinds(summary) == {("gap", "a")}
    assert (summary.violations[0].step, summary.components[0].gap) == (60, pytest.approx(0.5))
    within = run_arrays(100, leak=0.0)
    within["H"][60:, 0] += 0.5
    within["H0"] = np.vstack([[10.0, 10.0], within["H"][:-1]])
    assert kinds(judged(within, tmp_path / "within.parquet")) == {("change", "a")}
    slow = run_arrays(5000, leak=0.0)
    slow["H"][:, 0] += 1e10 + 1e-5 * np.arange(5000)
    slow["H0"] = np.vstack([[1e10 + 10.0, 10.0], slow["H"][:-1]])
    slow["moved"] = np.abs(slow["dH"])
    summary = judged(slow, tmp_path / "slow.parquet")
    assert kinds(summary) == {("drift", "a")}
    assert summary.components[0].gap == pytest.approx(0.05, rel=1e-2)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("column", ["dH", "H", "dissipated", "supplied", "port_energy"])
def test_what_is_not_a_number_is_a_violation(tmp_path: Path, column: str, bad: float):
    arrays = run_arrays(3, leak=0.0)
    arrays[column][1, 0] = bad
    summary = judged(arrays, tmp_path / "x.parquet")
    assert summary.components[0].verdict == "VIOLATED"
    assert summary.components[1].verdict == "closed"
    assert "VIOLATED" in audit_table(summary)


def test_energies_that_pass_within_a_component_count(tmp_path: Path):
    """Terms of +-1 J cancel in dH, H is 0: a residual of 1e-12 J is rounding, and only `moved` can say so."""
    small = {"h": 1.0, "H0": [[0.0, 0.0]], "H": [[1e-12, 1e-12]], "dH": [[1e-12, 1e-12]]}
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        book(ledger, Booking(("a", "b")), step=[0], t0=[0.0], **small, moved=[[0.0, 2.0]])
        book(ledger, Booking(("rest",)), step=[1], t0=[1.0], h=1.0, H=[[0.0]], dH=[[0.0]])
    assert {v.name for v in verdict(read(tmp_path / "x.parquet"))} == {"a"}


def test_estimated_ports_are_not_judged(tmp_path: Path):
    booking = Booking(("a",), (PortKey("a", "p", quality="estimated"),))
    half = {"supplied": [[0.5]], "port_energy": [[0.5]]}
    with AuditWriter(tmp_path / "x.parquet") as sink:
        book(Ledger(sink), booking, step=[0], t0=[0.0], h=1.0, H=[[1.0]], dH=[[0.0]], **half)
    table = read(tmp_path / "x.parquet")
    assert verdict(table) == []
    assert "estimated" in audit_table(table) and "closed" not in audit_table(table)


def test_a_unit_without_ports_and_books_has_no_verdict(tmp_path: Path):
    arrays = {"step": [0], "t0": [0.0], "h": 0.1, "H": [[0.0]], "dH": [[0.0]]}
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        book(ledger, Booking(("foreign",), silent=frozenset({"foreign"})), **arrays)
    summary = ledger.summary()
    assert summary.network is not None
    assert (summary.components[0].verdict, summary.network.verdict) == ("none", "none")
    assert "closed" not in audit_table(summary)
    assert summarise(tmp_path / "x.parquet") == summary


def test_names_in_a_log_are_text_on_a_terminal():
    """Control characters would move the cursor, and make up rows of the table."""
    ledger = Ledger()
    component = "a\x1b[31m\nb  closed"
    book(ledger, Booking((component,)), step=[0], t0=[0.0], h=0.1, H=[[0.0]], dH=[[1.0]])
    lines = audit_table(ledger.summary()).splitlines()
    assert all(line.isprintable() for line in lines)
    assert any(line.startswith(r"a\x1b[31m\nb  closed ") and line.endswith("VIOLATED") for line in lines)


def test_a_log_without_a_column_of_steps_is_no_log(tmp_path: Path):
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        book(ledger, Booking(("a",)), step=[0], t0=[0.0], h=0.1, H=[[0.0]], dH=[[0.0]])
    table = read(tmp_path / "x.parquet").drop_columns(["step"])
    with pytest.raises(ValueError, match="not an audit log: it has no column step"):
        summarise(table)


def test_energy_that_changes_between_steps_is_reported():
    """An event books what it added before the step that follows it."""
    for booked in (False, True):
        ledger = Ledger()
        book(ledger, Booking(("a",)), step=[0], t0=[0.0], h=1.0, H=[[1.0]], dH=[[0.0]])
        if booked:
            ledger.event(1.0, "impulse", "a", energy_jump=-0.5)
        book(ledger, Booking(("a",)), step=[1], t0=[1.0], h=1.0, H=[[0.5]], dH=[[0.0]])
        assert ("no event books it" in audit_table(ledger.summary())) is not booked
        assert ledger.summary().closed is booked


def test_one_event_that_changes_several_components_counts_once(tmp_path: Path):
    """Rows hold the energy per component; the table counts what happened."""
    with AuditWriter(tmp_path / "x.parquet") as sink:
        ledger = Ledger(sink)
        add_blocks(ledger, run_arrays(1, leak=0.0), 1)
        for t in (1.01, 1.02):
            ledger.event(t, "parameter", "a", 0.0, "k = 3")
            ledger.event(t, "parameter", "b", 0.0, "k = 3")
        ledger.event(1.02, "parameter", "b", 0.0, "k = 3")  # set again
        ledger.event(1.02, "input", message="u = 1")
        ledger.event(1.02, "input", message="u = 1")
    assert ledger.summary().events == {"parameter": 3, "input": 2}
    assert summarise(tmp_path / "x.parquet").events == ledger.summary().events
    assert "; 1 step from" in audit_table(ledger.summary())


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
    monkeypatch.setattr("phfmu.audit.reading.BATCH_ROWS", 1 << 11)
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
    monkeypatch.setattr("phfmu.audit.reading.COLUMN_BYTES", 1 << 20)
    with pytest.raises(
        ValueError, match=r"row group 0 unpacks its column 'row' from \d+ to \d+ bytes; at most 1048576"
    ):
        summarise(tmp_path / "bomb.parquet")


def test_steps_of_ports_without_an_index_are_booked_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The column of indices is empty where no port is a vector: steps of one booking stay one run."""
    booking = Booking(BOOKING.components, tuple(replace(p, port=f"p{p.index or 0}", index=None) for p in BOOKING.ports))
    with AuditWriter(tmp_path / "x.parquet") as sink:
        book(Ledger(sink), booking, **run_arrays(50))
    runs, booked = [], analysis._Reader._book_run

    def counted(self: analysis._Reader, grouped: Any, a: int, b: int) -> None:
        runs.append(b - a)
        booked(self, grouped, a, b)

    monkeypatch.setattr(analysis._Reader, "_book_run", counted)
    assert summarise(tmp_path / "x.parquet").steps == 50
    assert runs == [50]
