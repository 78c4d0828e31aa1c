"""The end of a step: guards over a trial, the first zero, the step that ends on it; the twin of
runtime/events/event_locate.c, event_trial.c and event_guards.c.

A step is tried, the guards are looked at on its collocation polynomial, and the first zero gives a first length of a shorter
step.  That step is taken again, and its length improved, until the guard is zero at its *end*.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.landing.event_jump import Guards
from phfmu.events.event_plan import EventPlan
from phfmu.events.roots import Crossing, crossing, fit, hermite_from_zero, slope, turn, vertex
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import StepFailure

Array = NDArray[Any]
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Trial:
    """A step of length h from t.

    start, near, end (n): guards at its start, soon after it and at its end;  fits: coefficients of each armed one;  from_zero:
    those that were zero at its start;  rates (n): largest mean rate of each guard between two points that were looked at;
    slopes (2 x n): d guard / dt at both ends, 0 where it is not known
    """

    t: float
    h: float
    start: Array
    near: Array
    end: Array
    fits: dict[int, Array]
    from_zero: set[int]
    rates: Array
    slopes: Array

    def rate(self, i: int, tau: float) -> float:
        """d guard / dt at the fraction tau."""
        return slope(self.fits[i], tau, i in self.from_zero) / self.h


class Location:
    """Takes steps of an instance that end where guards are zero."""

    CARRIED = ("_arrived",)

    def __init__(self, instance: Any, plan: EventPlan, guards: Guards):
        self.instance, self.plan, self.guards = instance, plan, guards
        #: |d guard / dt| (n) where the present instant was reached: a guard that was landed on is zero to rounding of the time
        self._arrived = np.zeros(plan.n)
        self._fit = fit(instance.model.step.k)

    def advance(self, t: float, h: float) -> tuple[float, list[int]]:
        """One accepted step from t, at most h long: its length (0: none was taken), and the events at its end."""
        before = self.instance.get_state()
        try:
            return self._located(before, t, h)
        except StepFailure:
            self.instance.restore(before)
            raise

    def _located(self, before: Any, t: float, h: float) -> tuple[float, list[int]]:
        instance = self.instance
        x, start, slopes, whole = instance.x, self._values(), self._slopes(), h
        inside = dict[int, bool]()  # at the ends of all steps so far, well inside
        for shorter in range(int(LIMITS["LEAVING_HALVINGS"]) + 1):
            h = self._tried(before, t, h)
            trial = self._trial(t, h, start, slopes, x)
            leaving = self._leaving(trial)
            if not leaving:
                break
            instance.restore(before)
            for i in leaving:
                returned = self.plan.direction[i] * trial.end[i] < 0 and not self._is_zero(trial, i, trial.end[i], 1.0)
                inside[i] = inside.get(i, True) and returned
            if shorter == LIMITS["LEAVING_ARC"] and all(inside[i] for i in leaving):
                h = self._tried(before, t, whole)
                trial = self._trial(t, h, start, slopes, x)
                break
            if shorter == LIMITS["LEAVING_HALVINGS"] or h / 2 <= LIMITS["GUARD_ARRIVED"] * EPS * abs(t):
                self._arrived = np.maximum(trial.rates, self._arrived)
                return 0.0, leaving
            h /= 2
        refused: set[int] = set()
        while found := self._first(trial, refused):
            i, at = found
            length = None if at.slope == 0 else self._land(before, trial, i, at)
            if length is None and i not in trial.from_zero and trial.start[i] * trial.end[i] > 0:
                length = self._turned(before, trial, i, at)
            if length is not None:
                self._arrived = trial.rates
                return length, self._together(trial, i, length)
            refused.add(i)  # the step map has no such zero: the guard only touches it
        if refused:
            instance.restore(before)
            instance.step_exactly(t, h)
        self._arrived = trial.rates
        return h, [
            i for i in trial.fits if self._is_zero(trial, i, trial.end[i], 1.0) and self._fits(i, trial.rate(i, 1.0))
        ]

    def _tried(self, before: Any, t: float, h: float) -> float:
        """Takes a step of at most h that needs no substeps, for its polynomial; its length."""
        while True:
            halved = self.instance.counts["substeps"]
            self.instance.step_exactly(t, h)
            if self.instance.counts["substeps"] == halved:
                return h
            self.instance.restore(before)
            h /= 2

    def _trial(self, t: float, h: float, start: Array, slopes: Array, x: Array) -> Trial:
        armed = [i for i in range(self.plan.n) if self._armed(i)]
        if not armed:
            unmoved = np.zeros(self.plan.n)
            return Trial(t, h, start, start, self._values(), {}, set(), unmoved, np.zeros((2, self.plan.n)))
        tau, inside = self._fit.tau, self._inside(t, h, x)
        values = np.vstack([start, inside, self._values()])
        zero = set()
        for i in armed:
            rate = abs(values[1, i] - values[0, i]) / (tau[1] * h)
            if abs(values[0, i]) <= max(self._zero(i, t, rate), self._rounded(t, i)):
                zero.add(i)
        if h <= LIMITS["GUARD_CLOCK"] * EPS * abs(t):  # they stay zero: what they do is rounding
            armed = [i for i in armed if i not in zero]
        fits = {i: self._fit.coefficients(values[:, i], i in zero) for i in armed}
        fits = {i: b for i, b in fits.items() if np.isfinite(b).all()}
        rates = np.fmax.reduce(np.abs(np.diff(values, axis=0)) / (np.diff(tau) * h)[:, None], axis=0, initial=0.0)
        rates = np.where(np.isfinite(rates), rates, 0.0)
        return Trial(t, h, start, values[1], values[-1], fits, zero, rates, np.vstack([slopes, self._slopes()]))

    def _inside(self, t: float, h: float, x: Array) -> Array:
        """Guards on the polynomial of the step just taken, at the points between its ends."""
        instance, after, w = self.instance, None, self.instance.unknowns
        if self.plan.solves:
            after = instance.get_state()
        y, p = self._read(), instance.parameters
        rows = []
        for tau in self._fit.tau[1:-1]:
            there = self.plan.polynomial(x, w, float(tau))
            if self.plan.solves:
                instance.set_x(t + tau * h, there)
                y = self._read()
            rows.append(self.guards.values(np.append(there, t + tau * h), y, p).copy())
        if after is not None:
            instance.restore(after)
        return np.array(rows)

    def _leaving(self, trial: Trial) -> list[int]:
        """Guards that are zero at the start and are on the other side from there on, as a step so long shows it."""
        found = []
        for i in sorted(trial.from_zero & trial.fits.keys()):
            direction = int(self.plan.direction[i])
            at = crossing(trial.fits[i], direction, True) if direction * trial.near[i] > 0 else Crossing(1.0, 0.0)
            if at is None or at.tau < LIMITS["PILE_UP"]:
                found.append(i)
        return found

    def _first(self, trial: Trial, refused: set[int]) -> tuple[int, Crossing] | None:
        best: tuple[int, Crossing] | None = None
        for i, b in trial.fits.items():
            if i in refused:
                continue
            at = crossing(b, int(self.plan.direction[i]), i in trial.from_zero) or self._turn(trial, i)
            if at is not None and (best is None or at.tau < best[1].tau):
                best = i, at
        return best

    def _turn(self, trial: Trial, i: int) -> Crossing | None:
        """The turn of a guard that no polynomial saw at zero, with the slope 0; a guard that left zero may cross it again."""
        begins, ends = (trial.slopes[:, i] * trial.h).tolist()
        if i in trial.from_zero:
            least = self._zero(i, trial.t + trial.h, abs(trial.slopes[0, i]))
            if not min(abs(begins), abs(trial.end[i])) > least:
                return None
            return crossing(hermite_from_zero(trial.end[i], begins, ends), int(self.plan.direction[i]), True)
        tau = turn(trial.start[i], trial.end[i], begins, ends)
        return None if tau is None else Crossing(tau, 0.0)

    def _turned(self, before: Any, trial: Trial, i: int, at: Crossing) -> float | None:
        """Land as `_land` does on a guard that turns back: steps that end there look for values beyond zero, by parabolas."""
        whole, side, back = trial.h, np.sign(trial.start[i]), self.plan.direction[i] == np.sign(trial.start[i])
        left, right = (0.0, trial.start[i] * side), (whole, trial.end[i] * side)  # lengths, distances from zero
        least, h = None, at.tau * whole
        for _ in range(int(LIMITS["TURN_TRIALS"])):
            self.instance.restore(before)
            self.instance.step_exactly(trial.t, h)
            now = h, float(self._values()[i]) * side
            if now[1] < -self._zero(i, trial.t, 0.0):  # `back`: what counts is how it leaves
                edge = right if back else left
                part = np.sqrt(-now[1] / (edge[1] - now[1]))  # the parabola that is least at h
                first = Crossing(
                    (h + part * (edge[0] - h)) / whole, 2 * side * (edge[1] - now[1]) * part / (edge[0] - h) * whole
                )
                return self._land(before, trial, i, first, *((h, whole) if back else (0.0, h)))
            if least is None or now[1] < least[1]:
                left, right = (left, right) if least is None else (least, right) if h > least[0] else (left, least)
                least = now
            else:
                left, right = (left, now) if h > least[0] else (now, right)
            h = vertex(left, least, right)
            if not left[0] < h < right[0] or abs(h - least[0]) <= LIMITS["TURN_CLOSE"] * whole:
                return None
        return None

    def _land(
        self, before: Any, trial: Trial, i: int, at: Crossing, low: float = 0.0, high: float = np.inf
    ) -> float | None:
        """The length of the step from trial.t at whose end guard i is zero, taken; None if there is none.

        By secants, within the lengths between which it changes its sign as far as they are known: low, high.  Where it goes
        beyond zero by more than rounding, that change alone tells where it is zero.
        """
        t, whole, sign = trial.t, trial.h, np.sign(at.slope)
        h, rate, last = at.tau * whole, at.slope / whole, None
        zero, passes = self._zero(i, t, 0.0), high < np.inf
        if high == np.inf and trial.end[i] * sign > 0:
            high, passes = whole, trial.end[i] * sign > zero
        trials = 0
        while trials < LIMITS["LANDING_TRIALS"] * (1 if high == np.inf else LIMITS["LANDING_BRACKETED"]):
            trials += 1
            self.instance.restore(before)
            self.instance.step_exactly(t, h)
            g = float(self._values()[i])
            if last is not None and h != last[0] and g != last[1]:
                secant = (g - last[1]) / (h - last[0])
                rate = secant if secant * sign > 0 else rate
            change = -g / rate if rate else np.inf
            low, high, last = (low, h, (h, g)) if g * sign > 0 else (h, high, (h, g))
            passes = passes or g * sign > zero
            if min(abs(change), high - low if passes else np.inf) <= LIMITS["LANDED"] * EPS * max(abs(t + h), h):
                return h
            if high == np.inf:
                if not 0 < h + change <= whole * (1 + 1e-9):
                    return None
                h = min(h + change, whole)
            else:
                slow = trials > LIMITS["LANDING_TRIALS"] and trials % 2
                h = (low + high) / 2 if slow or not low < h + change < high else h + change
        return None

    def _together(self, trial: Trial, i: int, length: float) -> list[int]:
        """Guard i and those that are zero with it."""
        values, tau = self._values(), length / trial.h

        def zero(j: int) -> bool:
            rate = trial.rate(j, tau)
            close = max(LIMITS["GUARD_TOGETHER"] * self.plan.nominal[j], self._zero(j, trial.t + length, abs(rate)))
            return abs(values[j]) <= close and self._fits(j, rate)

        return sorted([i, *(j for j in trial.fits if j != i and j not in trial.from_zero and zero(j))])

    def _read(self) -> Array:
        """[a | u] now."""
        instance = self.instance
        a = instance.signal("a_end") if self.plan.solves else np.zeros(instance.model.step.na)
        return np.concatenate([a, instance.held_input])

    def _values(self) -> Array:
        instance = self.instance
        return self.guards.values(np.append(instance.x, instance.time), self._read(), instance.parameters).copy()

    def _slopes(self) -> Array:
        """d guard / dt now, 0 where it is not known."""
        if not self.plan.rated.any():
            return np.zeros(self.plan.n)
        instance = self.instance
        return self.guards.rates(np.append(instance.x, instance.time), self._read(), instance.parameters).copy()

    def _armed(self, i: int) -> bool:
        when = self.plan.when
        return bool(np.all(self.instance.parameters[when.p[when.of(i)]] == when.value[when.of(i)]))

    def _zero(self, i: int, t: float, rate: float) -> float:
        return max(LIMITS["GUARD_ZERO"] * self.plan.nominal[i], LIMITS["GUARD_CLOCK"] * EPS * abs(t) * rate)

    def _rounded(self, t: float, i: int) -> float:
        """The largest rest of guard i if it was zero where this instant was reached."""
        return float(LIMITS["GUARD_ARRIVED"] * EPS * abs(t) * self._arrived[i])

    def _is_zero(self, trial: Trial, i: int, g: float, tau: float) -> bool:
        return abs(g) <= self._zero(i, trial.t + trial.h, abs(trial.rate(i, tau)))

    def _fits(self, i: int, rate: float) -> bool:
        return self.plan.direction[i] * rate > 0 or (self.plan.direction[i] == 0 and rate != 0)

    def already(self, t: float) -> list[int]:
        """Events that set modes and whose guards are beyond zero, after an event."""
        values = self._values()
        return [
            i
            for i in range(self.plan.n)
            if self._armed(i)
            and len(self.plan.sets.p[self.plan.sets.of(i)])
            and self.plan.direction[i] * values[i] > max(self._zero(i, t, 0.0), self._rounded(t, i))
        ]

    def begun(self, t: float, h: float) -> list[int]:
        """Events that set modes and whose guards are beyond zero where a step of at most h begins after something was set.

        The time itself is rounded there, so that a guard may be beyond zero by what it moves in that; a trial tells.
        """
        self._arrived = np.zeros(self.plan.n)
        found = self.already(t)
        if not found or h == 0.0:
            return found
        before = self.instance.get_state()
        try:
            x, start = self.instance.x, self._values()
            self._arrived = self._trial(t, self._tried(before, t, h), start, self._slopes(), x).rates
        except StepFailure:
            pass  # what it is beyond zero by is no rounding of a step that cannot be taken
        self.instance.restore(before)
        return self.already(t)
