"""The energy ledger: books close, whatever the blocks they come in; its log and its verdict have files of their own."""

import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phfmu.audit import (
    AuditWriter,
    Booking,
    Ledger,
    PortKey,
    book_steps,
    read,
    summarise,
    verdict,
)
from phfmu.audit.summing.sums import CompensatedSum
from phfmu.outcome.steps import Steps, balance
from tests.audit.arrays import BOOKING, add_blocks, book, run_arrays

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
