"""Claims of declared power ports: a unit that rests at zero input gives out no energy that it was not given, and its books close.

The energy through the ports since the start, from rest, is W(t) = sum over steps of h u^T y, positive into the unit.  A passive
unit keeps W >= 0 whatever its inputs do.  Drives look for W < 0: sines of many periods, sines after which the unit is braked by
inputs that oppose its outputs, which takes out all that it gives, and random moves from the worst of these.  It counts where it
grows with the length of the run and stays with half the step, so neither a store that the rest holds nor the quadrature is
blamed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.importer.reader import FMUInstance
from phfmu.outcome.status import StepFailure
from phfmu.vet.finding import ClaimFinding, false, holds, untested
from phfmu.vet.subject import MOVE, Subject
from phfmu.words import counted

Array = NDArray[np.float64]

#: steps of a run, of those before the brake, periods in steps, gains of the brake, and rounds of the search
LENGTH, KICK = 160, 40
PERIODS, GAINS, ROUNDS = (4.0, 12.0, 40.0, 160.0), (0.0, 0.03, 0.3, 3.0), 10
#: of the energy that went to and fro: what a quadrature may miss
MISSED = 0.01
#: of the size of an output: it rests
REST = 1e-9


@dataclass(frozen=True)
class _Drive:
    """Inputs of a run: sines of one period (in steps), with an amplitude and a phase for each pair (nu).

    `gain`: after the first steps the inputs are -gain y instead, in units of their size over that of the outputs; 0: never.
    """

    period: float
    size: Array
    phase: Array
    gain: float

    def sine(self, x: float) -> Array:
        return self.size * np.sin(2.0 * np.pi * x / self.period + self.phase)


def passivity(subject: Subject) -> ClaimFinding:
    """Energy through the declared ports, from rest, along sines and the worst input that a search finds."""
    if not subject.ports:
        return untested("no power ports are declared (a file UNIT.ports.toml beside it, a manifest or terminals)")
    try:
        moves = _moves_at_rest(subject)
        if moves:
            return untested(f"it does not rest at zero input ({moves}), so what it gives out may be its store")
        worst, found = _search(subject)
    except StepFailure as error:
        return untested(f"it refuses a step: {error}")
    given, gross = found
    if given >= -MISSED * gross:
        return holds(f"{gross:.3g} J to and fro at most, none given out that was not given before")
    longer, _ = _energy(subject, worst, 3 * LENGTH)
    finer, gross_finer = _energy(subject, worst, LENGTH, parts=2)
    if longer > 1.3 * given or finer > -MISSED * gross_finer or finer > 0.5 * given:
        return holds(f"from rest {-given:.3g} of {gross:.3g} J come out, which ends: a store, or the quadrature")
    how = "then braked" if worst.gain else "throughout"
    return false(
        f"from rest it gives out {-given:.3g} J of {gross:.3g} J exchanged in {LENGTH} steps, and {-longer:.3g} J in three times "
        f"as many (driven with a period of {worst.period * subject.h:.3g} s, {how})"
    )


def _made(subject: Subject) -> FMUInstance:
    return FMUInstance(subject.path, subject.ports, start=subject.t0, name="vetted")


def _moves_at_rest(subject: Subject) -> str:
    """The largest port output at zero input, in words; empty if the unit rests."""
    with _made(subject) as unit:
        scale = np.array([abs(unit.variable(n).nominal) for n in unit.outputs])
        unit.set_input(np.zeros(unit.nu))
        largest, t = np.abs(unit.end_output()), unit.time
        for k in range(12):
            unit.do_step(t + k * subject.h, subject.h)
            largest = np.maximum(largest, np.abs(unit.end_output()))
        if (largest <= REST * scale).all():
            return ""
        i = int(np.argmax(largest / scale))
        return f"{unit.outputs[i]} = {largest[i]:.3g}"


def _search(subject: Subject) -> tuple[_Drive, tuple[float, float]]:
    """The drive of the least energy for what goes to and fro, and both: sines first, then random moves from the worst."""
    dice = np.random.default_rng(1)
    with _made(subject) as unit:
        size = MOVE * np.array(
            [abs(unit.variable(n).nominal) + abs(unit.variable(n).start or 0.0) for n in unit.inputs]
        )
    n = len(size)
    drives = [_Drive(p, size, dice.uniform(0.0, 2.0 * np.pi, n), g) for p in PERIODS for g in GAINS]
    tried = [(d, _energy(subject, d, LENGTH)) for d in drives]
    worst = min(tried, key=_ratio)
    for _ in range(ROUNDS):
        if subject.left() < 0:
            break
        period = float(np.clip(worst[0].period * np.exp(0.5 * dice.standard_normal()), 3.0, 2.0 * LENGTH))
        moved = replace(
            worst[0],
            period=period,
            size=worst[0].size * np.exp(0.5 * dice.standard_normal(n)),
            phase=worst[0].phase + 0.7 * dice.standard_normal(n),
            gain=worst[0].gain * float(np.exp(0.5 * dice.standard_normal())),
        )
        worst = min(worst, (moved, _energy(subject, moved, LENGTH)), key=_ratio)
    return worst


def _ratio(found: tuple[_Drive, tuple[float, float]]) -> float:
    given, gross = found[1]
    return given / gross if gross else 0.0


def _energy(subject: Subject, drive: _Drive, length: int, parts: int = 1) -> tuple[float, float]:
    """The least W(t) of a run, and the sum of |h u^T y| (J)."""
    h, total, least, gross = subject.h / parts, 0.0, 0.0, 0.0
    with _made(subject) as unit:
        t, largest, u = unit.time, np.zeros(unit.nu), np.zeros(unit.nu)
        for k in range(length * parts):
            if k % parts == 0:
                y, x = unit.end_output(), k // parts
                largest = np.maximum(largest, np.abs(y)) if x <= KICK else largest
                braked = -drive.gain * drive.size / np.maximum(largest, 1e-300) * y
                u = braked if drive.gain and x >= KICK else drive.sine(x)
            unit.set_input(u)
            unit.do_step(t + k * h, h)
            work = float(np.sum(unit.ledger()["supplied"]))
            total += work
            gross += abs(work)
            least = min(least, total)
            if unit.steps.ended or subject.left() < 0:
                break
    return least, gross


def ledger(subject: Subject) -> ClaimFinding:
    """A unit that keeps books: stored + dissipated = supplied in each step, within rounding."""
    if not subject.interface.energy:
        return untested("it keeps no books of its energy")
    worst, k = 0.0, 0
    with _made(subject) as unit:
        u, t = unit.start_inputs(), unit.time
        for k in range(LENGTH):
            unit.set_input(u)
            unit.do_step(t + k * subject.h, subject.h)
            books = unit.ledger()
            residual = float(books["stored"][0] + books["dissipated"][0] - books["supplied"][0])
            scale = float(books.get("moved", books["stored"])[0]) + abs(float(books["supplied"][0]))
            worst = max(worst, abs(residual) / max(abs(scale), 1e-300) if residual else 0.0)
            if unit.steps.ended or subject.left() < 0:
                break
    if worst > 1e-9:
        return false(f"a step misses {worst:.2g} of the energy that it moves")
    return holds(f"{counted(k + 1, 'step')}, each to {worst:.1g} of the energy that it moves")
