"""Steps that end on the zeros of guards: location, jumps, what follows; the twin of runtime/events.c.

A step is tried over the rest of the grid step, the guards are looked at on its collocation polynomial, and the first zero gives
a first length of a shorter step.  That step is taken again, and its length improved, until the guard is zero at its *end*.
So a run is made of complete steps, each with its exact balance.  docs/understand/events.md has the rules.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.event_failure import EventRefused
from phfmu.engine.guards import Guards
from phfmu.engine.limits import LIMITS
from phfmu.engine.status import StepFailure
from phfmu.events.event_plan import EventPlan, Settings
from phfmu.events.happened import Happened, Landed
from phfmu.events.impulse import impulses
from phfmu.events.roots import Crossing, crossing, fit, slope

Array = NDArray[Any]
EPS = float(np.finfo(float).eps)
Taken = tuple[float, float, dict[str, Array]]  # a step: start, size, recorded row

DEPENDENT, MOST, GAIN, PILE, AGAIN = range(5)  # places in event_failure.REASONS


@dataclass(frozen=True)
class Trial:
    """A step of length h from t.

    near, end (n): guards soon after its start and at its end;  fits: coefficients of each armed one;  from_zero: those that
    were zero at its start
    """

    t: float
    h: float
    near: Array
    end: Array
    fits: dict[int, Array]
    from_zero: set[int]

    def rate(self, i: int, tau: float) -> float:
        """d guard / dt at the fraction tau."""
        return slope(self.fits[i], tau, i in self.from_zero) / self.h


class Landing:
    """Takes the steps of an instance with state events."""

    def __init__(self, instance: Any, plan: EventPlan):
        self.instance, self.plan = instance, plan
        self._guards = Guards(plan)
        self._fit = fit(instance.model.step.k)
        self._last = np.zeros(plan.n)  # when each event of the grid step happened last

    def over(
        self, t0: float, h: float, n: int, first: int, read: Callable[[], dict[str, Array]], changed: bool
    ) -> Iterator[Landed]:
        """Grid steps k = first..first+n-1 from t0 + k h; `read` makes the row of a step, `changed`: values were set before.

        StepFailure after the steps before it.
        """
        steps: list[Taken] = []
        try:
            for k in range(first, first + n):
                for found in self._grid_step(t0 + k * h, t0 + (k + 1) * h, h, read, changed):
                    if isinstance(found, Happened):
                        yield Landed.of(steps, found)
                        steps = []
                    else:
                        steps.append(found)
                changed = False
        except StepFailure:
            if steps:
                yield Landed.of(steps)
            raise
        if steps:
            yield Landed.of(steps)

    def _grid_step(
        self, t: float, end: float, h: float, read: Callable[[], dict[str, Array]], changed: bool
    ) -> Iterator[Taken | Happened]:
        """The steps and events in [t, end]."""
        events, self._last = 0, np.full(self.plan.n, -np.inf)
        fired = self._already(t) if changed else []
        while True:
            passes = 0
            while fired:
                events, passes = events + 1, passes + 1
                if passes > self.plan.n + 1:
                    self._refuse(t, AGAIN, fired)
                yield self._happen(t, h, fired, events)
                fired = self._already(t)
            if end - t <= (LIMITS["REST_OF_STEP"] * EPS * max(abs(t), abs(end)) if events else 0.0):
                return
            taken, fired = self._advance(t, end - t)
            if taken:
                yield t, taken, read()
                t = end if taken == end - t else t + taken

    # -- location ---------------------------------------------------------------------------------------------------

    def _advance(self, t: float, h: float) -> tuple[float, list[int]]:
        """One accepted step from t, at most h long: its length (0: none was taken), and the events at its end."""
        instance = self.instance
        before, x, start = instance.get_state(), instance.x, self._values()
        for shorter in range(int(LIMITS["LEAVING_HALVINGS"]) + 1):
            h = self._tried(before, t, h)
            trial = self._trial(t, h, start, x)
            leaving = self._leaving(trial)
            if not leaving:
                break
            instance.restore(before)
            if shorter == LIMITS["LEAVING_HALVINGS"]:
                return 0.0, leaving
            h /= 2
        refused: set[int] = set()
        while found := self._first(trial, refused):
            i, at = found
            length = self._land(before, trial, i, at)
            if length is not None:
                return length, self._together(trial, i, length)
            refused.add(i)  # the step map has no such zero: the guard only touches it
        if refused:
            instance.restore(before)
            instance.step_exactly(t, h)
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

    def _trial(self, t: float, h: float, start: Array, x: Array) -> Trial:
        armed = [i for i in range(self.plan.n) if self._armed(i)]
        if not armed:
            return Trial(t, h, start, self._values(), {}, set())
        tau, inside = self._fit.tau, self._inside(t, h, x)
        values = np.vstack([start, inside, self._values()])
        zero = set()
        for i in armed:
            rate = abs(values[1, i] - values[0, i]) / (tau[1] * h)
            if abs(values[0, i]) <= self._zero(i, t, rate):
                zero.add(i)
        fits = {i: self._fit.coefficients(values[:, i], i in zero) for i in armed}
        return Trial(t, h, values[1], values[-1], {i: b for i, b in fits.items() if np.isfinite(b).all()}, zero)

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
            rows.append(self._guards.values(np.append(there, t + tau * h), y, p).copy())
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
            at = None if i in refused else crossing(b, int(self.plan.direction[i]), i in trial.from_zero)
            if at is not None and (best is None or at.tau < best[1].tau):
                best = i, at
        return best

    def _land(self, before: Any, trial: Trial, i: int, at: Crossing) -> float | None:
        """The length of the step from trial.t at whose end guard i is zero, taken; None if there is none.

        By secants, within the lengths between which it changes its sign as far as they are known.
        """
        t, whole, sign = trial.t, trial.h, np.sign(at.slope)
        h, rate, last = at.tau * whole, at.slope / whole, None
        low, high = 0.0, whole if trial.end[i] * sign > 0 else np.inf
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
            if abs(change) <= LIMITS["LANDED"] * EPS * max(abs(t + h), h):
                return h
            low, high, last = (low, h, (h, g)) if g * sign > 0 else (h, high, (h, g))
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

    # -- guards -----------------------------------------------------------------------------------------------------

    def _read(self) -> Array:
        """[a | u] now."""
        instance = self.instance
        a = instance.signal("a_end") if self.plan.solves else np.zeros(instance.model.step.na)
        return np.concatenate([a, instance.held_input])

    def _values(self) -> Array:
        instance = self.instance
        return self._guards.values(np.append(instance.x, instance.time), self._read(), instance.parameters).copy()

    def _armed(self, i: int) -> bool:
        when = self.plan.when
        return bool(np.all(self.instance.parameters[when.p[when.of(i)]] == when.value[when.of(i)]))

    def _zero(self, i: int, t: float, rate: float) -> float:
        return max(LIMITS["GUARD_ZERO"] * self.plan.nominal[i], LIMITS["GUARD_CLOCK"] * EPS * abs(t) * rate)

    def _is_zero(self, trial: Trial, i: int, g: float, tau: float) -> bool:
        return abs(g) <= self._zero(i, trial.t + trial.h, abs(trial.rate(i, tau)))

    def _fits(self, i: int, rate: float) -> bool:
        return self.plan.direction[i] * rate > 0 or (self.plan.direction[i] == 0 and rate != 0)

    def _already(self, t: float) -> list[int]:
        """Events that set modes and whose guards are beyond zero, after something was set."""
        values = self._values()
        return [
            i
            for i in range(self.plan.n)
            if self._armed(i)
            and len(self.plan.sets.p[self.plan.sets.of(i)])
            and self.plan.direction[i] * values[i] > self._zero(i, t, 0.0)
        ]

    # -- what happens -----------------------------------------------------------------------------------------------

    def _happen(self, t: float, h: float, fired: list[int], events: int) -> Happened:
        instance, plan = self.instance, self.plan
        crowded = events >= LIMITS["MOST_EVENTS"]
        piled = [i for i in fired if crowded or t - self._last[i] < LIMITS["PILE_UP"] * h]
        rests = [i for i in piled if plan.rest.ptr[i + 1] > plan.rest.ptr[i]]
        if crowded and not rests:
            self._refuse(t, PILE, fired)
        energy, lost = self._jump(t, [i for i in fired if plan.jump is not None and plan.jump.of[i] >= 0], rests)
        p = instance.parameters
        for i in fired:
            _set(p, plan.sets, i)
        for i in rests:
            _set(p, plan.rest, i)
        instance.set_parameters(p)
        instance.initialise()
        self._last[fired] = t
        return Happened(t, tuple(fired), tuple(rests), energy, lost, _row(instance))

    def _jump(self, t: float, fired: list[int], rests: list[int]) -> tuple[Array, Array]:
        """Moves the states along L; by component the energy they get and what is lost."""
        instance, n = self.instance, self.instance.model.step.ncomp
        energy, lost = np.zeros(n), np.zeros(n)
        jump = self.plan.jump
        if jump is None or not fired:
            return energy, lost
        which = [int(jump.of[i]) for i in fired]
        x, p = instance.x, instance.parameters
        at = self._guards.columns(np.append(x, t), p).chosen(which)
        e = np.where([i in rests for i in fired], 0.0, at.e)
        before, goal, m = at.c.copy(), -(1.0 + e) * at.c.sum(axis=0), np.zeros(len(which))
        for j, c in enumerate(at.c.sum(axis=0)):
            if abs(c) > jump.most[which[j]]:
                self._refuse(t, MOST, [fired[j]], abs(float(c)), float(jump.most[which[j]]))
        for _ in range(2):  # the second corrects the rounding of the first
            found = impulses(at.S, goal)
            if found is None:
                self._refuse(t, DEPENDENT, fired)
            m += found
            x[jump.moved] += at.L @ found
            at = self._guards.columns(np.append(x, t), p).chosen(which)
            goal = -e * before.sum(axis=0) - at.c.sum(axis=0)
        work = m * (before + at.c) / 2  # components x jumps, exact as H is quadratic along L
        loss = -work.sum(axis=0)
        if -loss.sum() > LIMITS["LOSS_ROUNDING"] * np.abs(work).sum():
            self._refuse(t, GAIN, fired, float(-loss.sum()))
        energy[jump.component] = work.sum(axis=1)
        np.add.at(lost, jump.owner[which], loss)
        instance.set_x(t, x)
        return energy, lost

    def _refuse(self, t: float, reason: int, fired: list[int], value: float = 0.0, limit: float = 0.0) -> NoReturn:
        names = [self.plan.names[i] for i in fired]
        raise EventRefused(self.instance.model.name, t, reason, names, value, limit)


def _set(p: Array, settings: Settings, i: int) -> None:
    p[settings.p[settings.of(i)]] = settings.value[settings.of(i)]


def _row(instance: Any) -> Array:
    signals = instance.signals()
    return np.concatenate([signals[b] for b in instance.layout])


def landed(
    instance: Any, t0: float, h: float, n: int, record: Iterable[str], first: int, changed: bool
) -> Iterator[Landed]:
    """`land` of an instance; ValueError if its model has no state events."""
    if instance.model.events is None:
        raise ValueError(f"{instance.model.name} has no state events: use run")
    names, before = tuple(record), dict(instance.counts)

    def read() -> dict[str, Array]:
        nonlocal before
        spent = [float(instance.counts[name] - before[name]) for name in ("iterations", "solves")]
        before = dict(instance.counts)
        now = instance.ledger() | {"counts": np.array(spent), "unknowns": instance.unknowns, "x": instance.x}
        now |= {"signals": _row(instance), "energy": instance.signal("H")}
        now |= {name: instance.signal(name) for name in ("a", "y_step")}
        return {name: now[name].copy() for name in names}

    return Landing(instance, instance.model.events).over(t0, h, n, first, read, changed)
