"""Steps as the ledger takes them, and what follows from them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from phfmu.audit.booking import Booking
from phfmu.audit.summing.sums import Floats, Ints, across, across_each, plain
from phfmu.outcome.steps import Steps, balance


@dataclass(frozen=True, slots=True)
class BookedSteps:
    """n steps with what follows from them: [n] per step, [n,c] per component, [n,junctions] per junction; energies in joule.

    `in_play` is what a residual is measured against: the energies `inside` that moved within the component (`moved`, or
    else `varying`), |supplied|, |dissipated|, |numerical| and |energy| of each port pair. `varying`: max(|H0|, |H1|) without
    what of H is constant. `network` holds the columns of the network's row, each [n]. Made by `book_steps`.
    """

    booking: Booking
    step: Ints
    t0: Floats
    h: Floats
    H0: Floats
    steps: Steps
    residual: Floats
    varying: Floats
    inside: Floats
    in_play: Floats
    junction_residual: Floats
    junction_exchanged: Floats
    network: dict[str, Floats]
    relative: Floats | None = None  # filled in by who judges it


def book_steps(
    booking: Booking,
    step: ArrayLike,
    t0: ArrayLike,
    h: ArrayLike,
    steps: Steps,
    H0: ArrayLike | None = None,
    *,
    varying: ArrayLike | None = None,
) -> BookedSteps:
    """Copy n steps into a block and derive residuals, junctions and the network balance.

    Shapes: step (number), t0 [n], h [n] or scalar; H0 [n,c], at the starts of the steps; default H - stored;
    varying [n,c]: as it was recorded, by default it follows from the booking.
    Errors: ValueError naming the array and both shapes.
    """
    numbers = np.array(step, np.int64, ndmin=1)
    n, c, q = len(numbers), len(booking.components), len(booking.ports)
    s = _checked(steps, n, c, q, len(booking.parts))
    with np.errstate(invalid="ignore", over="ignore"):
        starts = s.H - s.stored if H0 is None else _table("H0", H0, (n, c))
        gone = 0.0 if s.numerical is None else s.numerical
        most = varying_energy(booking, starts, s.H)
        most = most if varying is None else np.minimum(_table("varying", varying, (n, c)), most)
        inside = np.maximum(most if s.moved is None else np.abs(s.moved), np.abs(s.stored))
        in_play = inside + np.abs(s.supplied) + np.abs(s.dissipated) + np.abs(gone)
        size, members = np.abs(s.pairs), list(booking.junctions.values())
        if q:
            in_play += plain(size, booking.owned)
        created, exchanged = across_each(s.pairs, members), 0.5 * across_each(size, members)
        residual = balance(s.stored, s.dissipated, s.supplied, gone)
        return BookedSteps(
            booking, numbers, _table("t0", t0, (n,)), np.broadcast_to(np.array(h, float), (n,)), starts, s, residual,
            most, inside, in_play, created, exchanged, _network(booking, s, created),
        )  # fmt: skip


def varying_energy(booking: Booking, H0: Floats, H1: Floats) -> Floats:
    """max(|H|, ..) of both ends [n,c]; of a component with a constant in H, of H without it if that is less."""
    most = np.maximum(np.abs(H0), np.abs(H1))
    if not booking.constants:
        return most
    c = np.array(booking.constants)
    return np.minimum(most, np.maximum(np.abs(H0 - c), np.abs(H1 - c)))


def _checked(s: Steps, n: int, c: int, q: int, parts: int) -> Steps:
    """A copy of the columns that are booked, of the right shapes."""
    shape = (n, c)
    return Steps(
        H=_table("H", s.H, shape),
        stored=_table("stored", s.stored, shape),
        dissipated=_table("dissipated", s.dissipated, shape),
        supplied=_table("supplied", s.supplied, shape),
        pairs=_table("pairs", s.pairs, (n, q)),
        numerical=_maybe("numerical", s.numerical, shape),
        moved=_maybe("moved", s.moved, shape),
        works=None if s.works is None else _table("works", s.works, (n, parts)),
        exchanged=_maybe("exchanged", s.exchanged, (n, q)),
        terms=None if s.terms is None else np.array(s.terms, np.float64, ndmin=2),
        iterations=_maybe("iterations", s.iterations, (n,)),
        accepted_by=None if s.accepted_by is None else np.array(s.accepted_by),
        rejected=_maybe("rejected", s.rejected, (n,)),
    )


def _network(booking: Booking, s: Steps, created: Floats) -> dict[str, Floats]:
    """Columns of the network: unexplained = balance of the sums, with the external supply, - junction residuals."""
    columns = {"H": across(s.H), "dH": across(s.stored), "dissipated": across(s.dissipated)}
    if s.numerical is not None:
        columns["numerical"] = across(s.numerical)
    if booking.external:
        js, signs = zip(*booking.external, strict=True)
        columns["external"] = across(s.pairs[:, list(js)] * np.array(signs))
    if booking.junctions:
        columns["junction_residual"] = across(created)
    none = np.zeros(len(s.H))
    left = balance(columns["dH"], columns["dissipated"], columns.get("external", none), columns.get("numerical", 0.0))
    columns["unexplained"] = left - columns.get("junction_residual", none)
    return columns


def _table(name: str, x: ArrayLike, shape: tuple[int, ...]) -> Floats:
    array = np.array(x, np.float64, ndmin=1)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape} (steps, columns of the booking)")
    return array


def _maybe(name: str, x: ArrayLike | None, shape: tuple[int, ...]) -> Floats | None:
    return None if x is None else _table(name, x, shape)
