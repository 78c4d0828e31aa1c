"""Blocks that compiled code sums and judges in one pass: the bits and the verdicts of arrays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle
from time import thread_time
from typing import Any

import numpy as np
import pytest

from phfmu import Monolithic, NativeInstance, build_model, default_scheme
from phfmu.audit import Booking, Ledger, LedgerSummary, PartKey, PortKey
from phfmu.audit.booking import PROJECTION
from phfmu.audit.kinds import Quality
from phfmu.audit.summing import sums
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.scenes.electrical.smib import smib
from phfmu.declare.phdae import PHDAE
from phfmu.outcome.steps import Steps
from phfmu.runs.book import Book

pytestmark = pytest.mark.usefixtures("compiler")
SIZES = (1, 7, 40, 152)


@pytest.fixture
def library() -> Iterator[Any]:
    """Compiled code is in use; afterwards as it was before."""
    before = sums.compiled()
    sums.use_compiled()
    yield sums.compiled()
    sums._library = before


#: a vector port, a component without energy (a relation), one that is estimated, a loss by projection, and ports from outside
BOOKING = Booking(
    ("a", "b", "stop", "unit"),
    (
        PortKey("a", "p", 1, "bus"),
        PortKey("b", "p", None, "bus"),
        PortKey("a", "p", 2, "bus"),
        PortKey("stop", "end", None, "wall"),
        PortKey("b", "end", None, "wall"),
        PortKey("a", "field"),
        PortKey("unit", "p", None, "bus", Quality.ESTIMATED),
        PortKey("grid", "p", None, "bus"),
    ),
    parts=(PartKey("bus", "node"), PartKey("bus", PROJECTION), PartKey("wall", "node")),
)


def balanced(n: int, seed: int, numerical: bool = True) -> Steps:
    """Steps that close to rounding, with junctions that lose a little by projections."""
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.integers(-6, 6, (n, 1))
    pairs = rng.normal(size=(n, 8)) * scale
    pairs[:, 3] = -pairs[:, 4]
    lost = -1e-6 * scale[:, 0] * rng.random(n)
    pairs[:, 7] = lost - pairs[:, [0, 1, 2, 6]].sum(axis=1)
    supplied = np.stack(
        [pairs[:, [0, 2, 5]].sum(axis=1), pairs[:, [1, 4]].sum(axis=1), pairs[:, 3], pairs[:, 6]], axis=1
    )
    dissipated, gone = 0.1 * np.abs(supplied), 0.01 * np.abs(supplied)
    stored = supplied - dissipated - (gone if numerical else 0.0)
    dissipated[:, 2], stored[:, 2], gone[:, 2] = supplied[:, 2], 0.0, 0.0  # the relation passes on what it gets
    dissipated[:, 2], supplied[:, 2] = 0.0, 0.0
    pairs[:, 3] = pairs[:, 4] = 0.0
    supplied[:, 1] = pairs[:, 1]
    stored[:, 1] = supplied[:, 1] - dissipated[:, 1] - (gone[:, 1] if numerical else 0.0)
    stored[:, 3] *= 0.9  # an estimate does not close
    works = np.stack([np.zeros(n), lost, np.zeros(n)], axis=1)
    H = 3.0 + np.cumsum(stored, axis=0)
    H[:, 2] = 0.0
    return Steps(H, stored, dissipated, supplied, pairs, gone if numerical else None, 2.0 * np.abs(stored), works=works)


def booked(booking: Booking, steps: Steps, size: int, jump: float = 0.0) -> LedgerSummary:
    ledger, h = Ledger(), 1e-3
    t = h * np.arange(len(steps.H))
    before = np.vstack([steps.H[:1] - steps.stored[:1], steps.H[:-1]])
    for i in range(0, len(t), size):
        part = steps.part(i, i + size)
        own = before[i : i + size].copy()
        if jump and i == 2 * size:
            ledger.event(float(t[i]), "state", "a", jump)
        ledger.add(booking, i + np.arange(len(part.H)), t[i : i + size], np.full(len(part.H), h), part, own)
    return ledger.summary()


def both(booking: Booking, steps: Steps, size: int, monkeypatch: pytest.MonkeyPatch) -> tuple[LedgerSummary, int]:
    """What compiled code says, which is what arrays say; how many blocks it took."""
    from phfmu.audit.summing.ordinary import Ordinary

    taken, take = [], Ordinary.take
    monkeypatch.setattr(Ordinary, "take", lambda *a: taken.append(take(*a)) or taken[-1])
    found = booked(booking, steps, size)
    with monkeypatch.context() as plain:
        plain.setattr(sums, "_library", None)
        assert repr(booked(booking, steps, size)) == repr(found)
    return found, sum(x is not None for x in taken)


@pytest.mark.parametrize("numerical", [True, False])
@pytest.mark.parametrize("size", SIZES)
def test_ordinary_blocks_have_the_bits_of_arrays(
    size: int, numerical: bool, library: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = balanced(152, 5, numerical)
    found, taken = both(BOOKING, steps, size, monkeypatch)
    assert found.closed, found.violations
    assert taken == -(-152 // size)
    assert {c.component: c.verdict for c in found.components}["unit"] == "estimated"


def test_bookings_of_every_kind_are_taken(library: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """No ports, no parts, no sums of single energies, loose junctions."""
    steps = replace(balanced(60, 3, False), moved=None)
    free = replace(steps, pairs=np.zeros((60, 0)), works=None, supplied=np.zeros((60, 4)), dissipated=-steps.stored)
    free = replace(free, stored=-np.abs(steps.stored), dissipated=np.abs(steps.stored))
    free = replace(free, H=50.0 + np.cumsum(free.stored, axis=0))
    for booking, own in ((Booking(BOOKING.components), free), (replace(BOOKING, loose=True), steps)):
        found, taken = both(booking, own, 20, monkeypatch)
        assert taken == 3, found.violations


@pytest.mark.parametrize(("left", "closes"), [(4e-39, True), (1e-24, False)])
def test_what_moves_as_one_closes_to_rounding_of_rounding(
    left: float, closes: bool, library: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two bodies at one speed, with nothing in play but what the force of a rounding does at their junction."""
    booking = Booking(("a", "b"), (PortKey("a", "p", None, "rod"), PortKey("b", "p", None, "rod")))
    pairs = np.tile([2.0 * left, -left], (5, 1))
    zero = np.zeros((5, 2))
    steps = Steps(np.tile([0.5, 1.5], (5, 1)), pairs, zero, pairs, pairs, None, zero)
    found, taken = both(booking, steps, 5, monkeypatch)
    assert (found.closed, taken) == (closes, closes)


@pytest.mark.parametrize(
    ("left", "right", "closes"),
    [(1e-11, -1e-11, True), (1e-11, -1.5e-11, False), (1e-11, 1e-11, False), (1e-8, -1e-8, False)],
)
def test_what_a_stiff_member_passes_on_closes_where_junctions_cancel(
    left: float, right: float, closes: bool, library: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two bodies of 100 J and a spring between them that is carried along; rtol of the energies is 2e-9 J."""
    ports = (
        PortKey("a", "p", None, "ja"),
        PortKey("s", "a", None, "ja"),
        PortKey("b", "p", None, "jb"),
        PortKey("s", "b", None, "jb"),
    )
    pairs = np.tile([left, 0.0, right, 0.0], (5, 1))
    stored = np.tile([left, right, 0.0], (5, 1))
    H = [100.0, 100.0, 0.0] + np.cumsum(stored, axis=0)
    steps = Steps(H, stored, np.zeros((5, 3)), stored, pairs, None, np.abs(stored))
    found, _ = both(Booking(("a", "b", "s"), ports), steps, 5, monkeypatch)
    assert found.closed is closes


@pytest.mark.parametrize(("off", "closes"), [(1.0, True), (40.0, False)])
def test_H_has_the_rounding_of_energies_that_cancel(off: float, closes: bool, library: Any) -> None:
    """A body falls: 3e4 J a step go from one energy to the other, and their sum of 2 J has the rounding of both."""
    n, moved = 10000, 3e4
    rounding = np.spacing(n * moved) * off * (np.arange(1, n + 1) / n)
    H = 2.0 + rounding * np.where(np.arange(n) % 2, 1.0, -1.0)
    zero = np.zeros((n, 1))
    steps = Steps(H[:, None], zero, zero, zero, np.zeros((n, 0)), None, np.full((n, 1), moved))
    ledger, size, before = Ledger(rtol=1e-15), 1000, np.vstack([[[2.0]], H[:-1, None]])  # rounding alone is allowed
    for i in range(0, n, size):
        k = i + np.arange(size)
        ledger.add(Booking(("body",)), k, 1e-2 * k, np.full(size, 1e-2), steps.part(i, i + size), before[k])
    found = ledger.summary()
    assert found.closed is closes, found.violations
    assert {v.kind for v in found.violations} == (set() if closes else {"change"})


@pytest.mark.parametrize("column", ["H", "stored", "dissipated", "supplied", "numerical", "moved", "pairs", "works"])
def test_what_is_not_ordinary_is_told_as_by_arrays(column: str, library: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the middle of a block, in each column; the blocks beside it are compiled code's."""
    steps = balanced(60, 9)
    for j, wrong in zip(range(getattr(steps, column).shape[1]), cycle([np.nan, -1e3, np.inf, 1e3]), strict=False):
        table = getattr(steps, column).copy()
        table[33, j] += wrong * (1.0 + np.abs(table[33]).sum())
        found, taken = both(BOOKING, replace(steps, **{column: table}), 20, monkeypatch)
        assert taken <= 3 and not (np.isnan(wrong) and found.closed and column != "moved")


@pytest.mark.parametrize(
    ("declaration", "step"), [(smib().declaration(), 1e-4), (four_particle(), 1e-3)], ids=["smib", "four_particle"]
)
def test_the_sums_of_a_run_cost_less_than_a_twentieth(declaration: PHDAE, step: float, library: Any) -> None:
    """CPU time of the least of several turns."""
    model = build_model(declaration, default_scheme(declaration, 2))
    stepper, n = Monolithic(model, NativeInstance(model)), 2048
    t, h = step * np.arange(n), np.full(n, step)
    spent: dict[str, list[float]] = {"engine": [], "ledger": []}
    book = Book(stepper, Ledger())
    stepper.prepare(0.0, step)
    book.start()
    for turn in range(8):
        begun = thread_time()
        steps = stepper.advance(turn * n * step, step, n)
        stepped = thread_time()
        book.add(t + turn * n * step, h, steps)
        spent["engine"].append(stepped - begun)
        spent["ledger"].append(thread_time() - stepped)
    assert book.ledger.summary().closed
    assert min(spent["ledger"]) <= 0.05 * min(spent["engine"])
