"""The judge of a ledger: the one place that says what closes, for the ledger of a run and for the file of one.

A step is measured against the energies in play in it and, as rounding, against those that were in play so far,

    |residual| <= allowed = rtol P + REACH_ULPS eps max(P, |sum dH|) + ULPS eps V + LEAST,
    P = (moved or V) + |dissipated| + |numerical| + |supplied| + sum |port energies|,

with the maximum over the run up to the step.  `moved` is the sum over the component's energies of |change|; V = max(|H0|, |H1|)
without what of H is constant, to which energies that pass between the states of a term have their rounding.  A component
of which no energy has moved yet is allowed ULPS eps of the sum of max P over all components besides.  What the steps of a
run miss together may be DEVIATIONS times the root of the sum of the squares of what they are allowed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booked_steps import BookedSteps
from phfmu.audit.booking import PROJECTION, Booking
from phfmu.audit.kinds import Quality
from phfmu.audit.summing.sums import CompensatedSum, Floats, add, all_finite, largest_so_far, plain, ratio, rows
from phfmu.audit.violation import Violation, ViolationKind
from phfmu.outcome.limits import defined

EPS = float(np.finfo(float).eps)
HEADER = Path(__file__).parent.parent / "engine" / "runtime" / "judge.h"
DEFAULT_RTOL, REACH_ULPS, ULPS, PARTS, DEVIATIONS, LEAST = (
    defined(HEADER)[name] for name in ("RTOL", "REACH_ULPS", "ULPS", "PARTS", "DEVIATIONS", "LEAST")
)


@dataclass(slots=True)
class ComponentBalance:
    """The record of a component from step to step; energies in joule."""

    H_start: float
    H_end: float
    quality: Quality = Quality.EXACT
    reach: float = 0.0  # most energy in play so far
    largest: float = 0.0  # |H|
    moved: float = 0.0  # most that moved within it in a step
    turnover: float = 0.0  # sum over the steps of what moved within it
    jumps: float = 0.0  # booked by events since the last step
    gap: CompensatedSum = field(default_factory=CompensatedSum)
    missed: CompensatedSum = field(default_factory=CompensatedSum)  # residuals
    squares: CompensatedSum = field(default_factory=CompensatedSum)  # of what is allowed in the steps
    worst_ratio: float = -1.0
    worst_residual: float = 0.0
    worst_step: int = 0
    worst_t0: float = math.nan

    @property
    def allowed(self) -> float:
        """The bound on the sum of the residuals of the run."""
        return DEVIATIONS * math.sqrt(max(self.squares.value, 0.0))


class Judge:
    """Judges blocks of steps one after the other; `rtol` is relative to the energies in play."""

    def __init__(self, rtol: float = DEFAULT_RTOL) -> None:
        self.rtol = rtol
        self.accounts: dict[str, ComponentBalance] = {}
        self.passed: dict[str, float] = {}  # most that passed through each junction in a step
        self.squares = CompensatedSum()  # of what may be unexplained in the steps
        self._found: dict[tuple[ViolationKind, str], Violation] = {}

    def steps(self, block: BookedSteps, stored: Floats) -> Floats:
        """Judge a block; `stored` [n,c] are the sums of dH up to each step.

        Returns DEFAULT_RTOL |residual| / allowed [n,c] with what DEFAULT_RTOL allows: it does not depend on `rtol`.
        """
        booking, names = block.booking, block.booking.components
        accounts = self.known(booking, block.H0)
        judged = np.array(booking.exact, bool)
        in_play = _or(math.nan, block.in_play)
        reach = largest_so_far([a.reach for a in accounts], _larger_finite(in_play, np.abs(stored)))
        with np.errstate(invalid="ignore", over="ignore"):
            H, varying = _larger_finite(np.abs(block.H0), np.abs(block.steps.H)), _or(0.0, block.varying)
            relations = self._relations(accounts, _or(0.0, block.inside), reach)
            rounding, of_H = REACH_ULPS * EPS * reach + LEAST, ULPS * EPS * (varying + relations)
            in_step = self.rtol * in_play + rounding
            allowed = in_step + of_H
            self._mark(ViolationKind.BALANCE, names, block.residual, allowed, block, judged)
            self._mark(
                ViolationKind.DISSIPATION, names, np.minimum(block.steps.dissipated, 0.0), allowed, block, judged
            )
            if names:
                booked = block.steps.supplied - plain(block.steps.pairs, booking.owned)
                self._mark(ViolationKind.PORTS, names, booked, allowed, block, judged)
            self._ports(block, allowed)
            changes = self._changes(accounts, block, in_step, H)
            missed = allowed if judged.all() else np.where(judged, allowed, np.abs(block.residual))
            joined = self._joined(block, missed, reach, varying)
            self._add(accounts, (changes, block.residual, allowed * allowed, joined * joined))
        found = ratio(block.residual, allowed)
        for i, account in enumerate(accounts):
            account.reach = float(reach[-1, i])
            self._keep_worst(account, block, found[:, i], i)
        if self.rtol != DEFAULT_RTOL:
            found = ratio(block.residual, DEFAULT_RTOL * in_play + rounding + of_H)
        return DEFAULT_RTOL * found

    def _ports(self, block: BookedSteps, allowed: Floats) -> None:
        """Books of ports against the values that were exchanged there; `allowed` [n,c]."""
        told, booking = block.steps.exchanged, block.booking
        if told is None:
            return
        names = tuple(f"{p.component}.{p.port}" for p in booking.ports)
        at = {name: i for i, name in enumerate(booking.components)}
        own = [at.get(p.component, -1) for p in booking.ports]
        within = np.where([i >= 0 for i in own], allowed[:, own], np.inf) + self.rtol * np.abs(told)
        self._mark(ViolationKind.EXCHANGED, names, told - block.steps.pairs, within, block)

    def _add(self, accounts: list[ComponentBalance], columns: tuple[Floats, Floats, Floats, Floats]) -> None:
        """To the sums of the run, all at once: what they cost is the call, where events make the blocks short."""
        sums = [a.gap for a in accounts], [a.missed for a in accounts], [a.squares for a in accounts]
        add([*chain(*sums), self.squares], np.concatenate(columns, axis=1))

    def _relations(self, accounts: list[ComponentBalance], inside: Floats, reach: Floats) -> Floats:
        """Energies in play in the network [n,c] where none has moved `inside` a component yet, else 0.

        It is a relation, as a junction is, solved with all others at once: a stop that holds a body at rest passes no energy
        on, but the force on it and the rounding of a velocity.
        """
        moved = np.array([a.moved for a in accounts])
        if (moved > 0.0).all():
            return np.zeros_like(inside)
        moved = np.maximum.accumulate(np.maximum(inside, moved), axis=0)
        for account, most in zip(accounts, moved[-1].tolist(), strict=True):
            account.moved = most
        return np.where(moved == 0.0, rows(reach)[:, None], 0.0)

    def known(self, booking: Booking, H0: Floats) -> list[ComponentBalance]:
        """The accounts of the components; those that are new begin with the first row of H0 [n,c]."""
        for i, name in enumerate(booking.components):
            if name not in self.accounts:
                self.accounts[name] = ComponentBalance(float(H0[0, i]), float(H0[0, i]))
            if not booking.exact[i]:
                self.accounts[name].quality = booking.quality(name)
        return [self.accounts[name] for name in booking.components]

    def _changes(self, accounts: list[ComponentBalance], block: BookedSteps, allowed: Floats, H: Floats) -> Floats:
        """H from step to step and within each, against what is booked: the difference; `H` [n,c]: max(|H0|, |H1|)."""
        names, H1 = block.booking.components, block.steps.H
        before = np.empty_like(block.H0)
        before[0] = [a.H_end + a.jumps for a in accounts]
        before[1:] = H1[:-1]
        largest = largest_so_far([a.largest for a in accounts], H)
        permitted = allowed + _rounding_of_H(largest, self._turnover(accounts, block))
        between, within = block.H0 - before, H1 - block.H0 - block.steps.stored
        self._mark(ViolationKind.GAP, names, between, permitted, block)
        self._mark(ViolationKind.CHANGE, names, within, permitted, block)
        for i, account in enumerate(accounts):
            account.largest, account.H_end, account.jumps = float(largest[-1, i]), float(H1[-1, i]), 0.0
        return between + within

    def _turnover(self, accounts: list[ComponentBalance], block: BookedSteps) -> Floats:
        """Sums up to each step [n,c] of what moved between the energies of a component: what these may have become by then."""
        moved = block.steps.moved
        steps = np.zeros_like(block.H0) if moved is None else np.abs(_or(0.0, np.asarray(moved, float)))
        sums = np.cumsum(np.vstack([[a.turnover for a in accounts], steps]), axis=0)[1:]
        for account, last in zip(accounts, sums[-1].tolist(), strict=True):
            account.turnover = last
        return sums

    def _joined(self, block: BookedSteps, allowed: Floats, played: Floats, varying: Floats) -> Floats:
        """Junctions, and the network: what is unexplained is the sum of what the components miss, or are not judged for.

        Returns what may be unexplained in each step [n,1].

        All junctions are solved for at once, so each has roundings of the energies in play in the whole network, however little
        passes through it: `played` [n,c].  Where all move at one speed, what is left is the force of a rounding times
        the speed of another, rounding of rounding of H: `varying` [n,c].  A stiff member that is carried along passes the
        rounding of its ends from one junction to the next: what all of them create together is rounding, each within rtol of H.
        """
        names = tuple(block.booking.junctions)
        if names:
            passed = 2.0 * block.junction_exchanged
            reach = largest_so_far([self.passed.get(name, 0.0) for name in names], _or(0.0, passed).copy())
            self.passed.update(zip(names, reach[-1].tolist(), strict=True))
            judged = np.full(len(names), not block.booking.loose)
            rounding = ULPS * EPS * rows(played) + (ULPS * EPS) ** 2 * rows(varying)
            permitted = self.rtol * passed + REACH_ULPS * EPS * reach + LEAST + rounding[:, None]
            created = block.junction_residual - self._lost(block)
            passed_on = np.abs(rows(created)) <= rounding + ULPS * EPS * rows(np.abs(created))
            permitted += np.where(passed_on, self.rtol * rows(varying), 0.0)[:, None]
            self._mark(ViolationKind.JUNCTION, names, created, permitted, block, judged)
            self._divided(block, permitted)
        permitted = (rows(allowed) + ULPS * EPS * rows(np.abs(block.steps.pairs)))[:, None]
        self._mark(ViolationKind.UNEXPLAINED, ("network",), block.network["unexplained"][:, None], permitted, block)
        return permitted

    def _lost(self, block: BookedSteps) -> Floats:
        """Energy that junctions have lost by projections [n,junctions], which is booked; what these would have created is not."""
        lost, works, names = np.zeros_like(block.junction_residual), block.steps.works, list(block.booking.junctions)
        for i, key in enumerate(block.booking.parts if works is not None else ()):
            if works is not None and key.part == PROJECTION:
                lost[:, names.index(key.junction)] += np.minimum(works[:, i], 0.0)
        return lost

    def _divided(self, block: BookedSteps, permitted: Floats) -> None:
        """The parts of a junction's energy add up to it, whether it is small or not."""
        works, divided = block.steps.works, block.booking.divided
        if works is None or not divided:
            return
        names = tuple(block.booking.junctions)
        at = [names.index(name) for name in divided]
        sums = plain(works, list(divided.values()))
        self._mark(ViolationKind.PARTS, tuple(divided), block.junction_residual[:, at] - sums, permitted[:, at], block)

    def _keep_worst(self, account: ComponentBalance, block: BookedSteps, found: Floats, i: int) -> None:
        k = int(np.argmax(found))
        if found[k] > account.worst_ratio:
            account.worst_ratio, account.worst_residual = float(found[k]), float(block.residual[k, i])
            account.worst_step, account.worst_t0 = int(block.step[k]), float(block.t0[k])

    def _mark(
        self,
        kind: ViolationKind,
        names: Sequence[str],
        size: Floats,
        allowed: Floats,
        block: BookedSteps,
        judged: NDArray[np.bool_] | None = None,
    ) -> None:
        """Note where |size| exceeds `allowed` [n,m]; what is not a finite number does, judged or not."""
        within = np.abs(size) <= allowed
        if within.all() and all_finite(size):
            return
        size_known = np.isfinite(size)
        bad = ~(within & size_known)
        if judged is not None:
            bad &= judged | ~size_known
        if not bad.any():
            return
        for i in np.flatnonzero(bad.any(axis=0)).tolist():
            at = np.flatnonzero(bad[:, i])
            k = at[int(np.argmax(ratio(size[at, i], allowed[at, i])))]
            numbers = (int(block.step[k]), float(block.t0[k]), float(block.h[k]))
            self.note(Violation(kind, names[i], *numbers, float(size[k, i]), float(allowed[k, i]), len(at)))

    def note(self, violation: Violation) -> None:
        """Keep the worst of a kind at a place, and count its steps."""
        key = violation.kind, violation.name
        known = self._found.get(key)
        worst = violation if known is None or violation.ratio > known.ratio else known
        self._found[key] = replace(worst, steps=violation.steps + (known.steps if known else 0))

    @property
    def quality(self) -> Quality:
        """The quality of the network: estimated where a component is, none where no component tells anything."""
        found = {account.quality for account in self.accounts.values()}
        return (
            Quality.ESTIMATED
            if Quality.ESTIMATED in found
            else Quality.SILENT
            if found == {Quality.SILENT}
            else Quality.EXACT
        )

    def jump(self, component: str, energy: float) -> None:
        """An event between the steps added energy [J] to a component's H."""
        if component in self.accounts:  # what happens before its first step is its start
            self.accounts[component].jumps += energy

    def violations(self, unexplained: float = 0.0) -> list[Violation]:
        """Violations so far, also those that are small in each step but not in the run; `unexplained` [J]: in all of it."""
        found = list(self._found.values())
        for name, a in self.accounts.items():
            if a.quality is Quality.EXACT:
                found += self._in_run(ViolationKind.RUN, name, a.missed.value, a.allowed, ViolationKind.BALANCE)
            allowed, steps = (
                a.allowed + _rounding_of_H(a.largest, a.turnover),
                (ViolationKind.GAP, ViolationKind.CHANGE),
            )
            found += self._in_run(ViolationKind.DRIFT, name, a.gap.value, allowed, *steps)
        allowed, steps = DEVIATIONS * math.sqrt(max(self.squares.value, 0.0)), ViolationKind.UNEXPLAINED
        return [*found, *self._in_run(ViolationKind.UNEXPLAINED_RUN, "network", unexplained, allowed, steps)]

    def _in_run(
        self, kind: ViolationKind, name: str, size: float, allowed: float, *steps: ViolationKind
    ) -> list[Violation]:
        """A violation where the sum over the run exceeds `allowed`, and no kind of `steps` tells of single ones."""
        if abs(size) <= allowed or any((single, name) in self._found for single in steps):
            return []
        return [Violation(kind, name, 0, math.nan, math.nan, size, allowed)]


def _rounding_of_H(largest: Any, turnover: Any) -> Any:
    """Bound on the difference between H and what is booked of it, by rounding [J]; `ph_rounding_of_H`."""
    return ULPS * EPS * largest + PARTS * EPS * turnover


def _or(other: float, x: Floats) -> Floats:
    """x, with `other` in place of numbers that are not finite."""
    return x if all_finite(x) else np.where(np.isfinite(x), x, other)


def _larger_finite(a: Floats, b: Floats) -> Floats:
    """The larger of a, b >= 0 elementwise; what is not a finite number counts as 0."""
    larger = np.maximum(a, b)
    return larger if all_finite(larger) else np.maximum(_or(0.0, a), _or(0.0, b))
