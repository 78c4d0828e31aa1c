"""Steps of coupled members whose size follows the energy at their junctions.

A coupling holds what members exchange over a step, so its junctions may make energy, and they hide some: of power u(t) y(t)
a step books h U Y, the product of the means.  For junction k with ports i, in a step of length h,

    made_k = |sum_i h U_i Y_i|,     hidden_k = h/24 sum_i |dU_i dY_i|,     e_k = sum_i |h U_i Y_i| / 2,

with dU, dY the changes over the step, by the means of the step before: hidden_k is the integral of (u - U)(y - Y) of signals
that are linear in time, half of it at each side of the junction.  made_k is left out where steps are repeated until junctions
make nothing.

`--energy-rtol R`: in each step every junction keeps

    made_k + hidden_k <= R sqrt((E_k + A) (e_k + h P_k + A)),

with E_k the energy that has passed through it in the run, P_k the power of the last ten steps or so, and A the larger of `--atol`
[J] (default 0) and of what passes in the first trial, of length `--step`: from rest all of a short step may be residual.  An
energy dE that is lost at a level E moves amplitudes by dE / sqrt(E), so the right side asks for an error of amplitudes relative
to the largest so far.  The junction with the largest ratio decides.  Where all members can take a step back, one that misses
the tolerance is taken again; else only the next one is smaller.  The audit tells of each step how often (`rejected`).

`--ecco TOL` (energy-conservation-based co-simulation): eps^2 = 1/N sum_k (made_k / (TOL (1 J + e_k)))^2 for couplings that take
each step once, none again.
Source: Sadjina, Kyllingstad, Skjong, Pedersen, Engineering with Computers 33 (2017) 607; its numbers as in libcosim.

Both follow a PI controller, h <- h s e^-a e_last^b, within [least, most] times the last step.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.coupling import solves_rows
from phfmu.network.couplings.coupling_table import COUPLINGS
from phfmu.network.couplings.stepper import Stepper
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import Steps
from phfmu.runs.march.adaptive import GROW, INTEGRAL, PROPORTIONAL, SAFETY, SHRINK
from phfmu.runs.options import Options
from phfmu.words import counted

Array = NDArray[Any]

NOTHING = 1e-12  # an error below this is this
FLOOR = 1.0  # J, of which ECCO allows the tolerance beside the energy exchanged
MEMORY = 0.1  # part of the last step in the mean power of the last ones
TINY = 1e-300  # J
HIDDEN = 1.0 / 24.0  # half of the mean of s^2 on [-1/2, 1/2]
NEAR = 1e-9  # of a step: what is left is all of it
LEAST = 1e-6  # of `--step`: steps are not shorter than that or `--min-step`


@dataclass(frozen=True)
class PIParameters:
    """The numbers of a PI controller of step sizes; it acts from step `first` on."""

    safety: float
    integral: float
    proportional: float
    least: float
    most: float
    first: int


ECCO = PIParameters(0.8, 0.35, 0.2, 0.2, 1.5, 2)


def pi_parameters(order: int) -> PIParameters:
    """The controller of steps that keep a tolerance, for residuals of this order in h."""
    return PIParameters(SAFETY, INTEGRAL / order, PROPORTIONAL / order, SHRINK, GROW, 2)


class EnergySteps:
    """Steps of a `Coupled` by the energy residual of its junctions; raises ValueError where the option means nothing there."""

    CARRIED = (
        "_h", "_last", "_steps", "_smallest", "_largest", "_rejected", "_missed", "_exchanged", "_power", "_floor", "_before",
    )  # fmt: skip

    def __init__(self, stepper: Stepper, options: Options):
        self._ecco = options.ecco is not None
        self.stepper = _ecco_fits(stepper) if self._ecco else _fits(stepper)
        tolerance = options.ecco if self._ecco else options.energy_rtol
        assert tolerance is not None
        joined = self.stepper.joined
        #: members that cannot take a step back; where there is one, no step is taken again
        self.stuck = [m.name for m in joined.members if not m.saves or m.finishes]
        self._again = not self._ecco and not self.stuck
        self._makes = not self.stepper.solves_rows or bool(joined.put_off)
        #: of the residuals in h
        self._order = 2 if self._makes else 3
        self._controller = ECCO if self._ecco else pi_parameters(self._order)
        self._rtol, self._atol = tolerance, options.atol or 0.0
        self._first, self._max_step = options.step, options.max_step
        self._min_step = options.min_step or (0.0 if self._ecco else min(LEAST * options.step, options.max_step))
        self._h, self._last, self._steps = min(options.step, self._max_step), 1.0, 0
        self._smallest, self._largest, self._rejected, self._missed = math.inf, 0.0, 0, 0
        between = {j.name for j in joined.network.junctions}  # those inside a composed member exchange nothing
        booked = {n: place for n, place in self.stepper.booking.junctions.items() if n in between}
        self._junctions, self._ports = list(booked.values()), _ports(self.stepper, booked)
        #: by junction: energy that has passed through it, mean power of the last steps
        self._exchanged, self._power = np.zeros((2, len(self._junctions)))
        #: by junction, A; None before the first trial
        self._floor: Array | None = None
        #: inputs and outputs of the last step, and its length
        self._before: tuple[Array, Array, float] | None = None

    def after_event(self) -> None:
        """Forget the last step: what comes is not its continuation."""
        self._last, self._before = 1.0, None
        if not self._ecco:
            self._h = min(self._first, self._max_step)

    def facts(self) -> dict[str, float]:
        """Rejected trials, smallest and largest step (s)."""
        return {"rejected": self._rejected, "smallest": self._smallest, "largest": self._largest}

    def notes(self) -> list[str]:
        """Notes of what was not as asked for, one line each."""
        told = []
        if self.stuck and not self._ecco:
            told.append(
                f"{', '.join(self.stuck)} cannot take a step back: no step was taken again, --energy-rtol sized "
                "the next ones only"
            )
        if self._missed:
            told.append(f"{counted(self._missed, 'step')} of those taken missed --energy-rtol {self._rtol:g}")
        return told

    def march(self) -> None:
        """Members are stepped one by one: there is no compiled loop."""

    def advance(self, t: float, end: float, restart: bool = False) -> tuple[list[float], Steps]:
        """One step from t, not beyond `end`: where it ends (`end` to the last bit), and the step."""
        limit, rejected = self._controller.most, self._rejected
        while True:
            left = end - t
            whole = self._h >= left * (1 - NEAR)
            h = left if whole else self._h if 2 * self._h <= left else left / 2
            least = self._min_step * (1 + NEAR)
            kept = self.stepper.kept() if self._again else None
            try:
                steps = self.stepper.advance(t, h, 1)
            except StepFailure:
                if kept is None or h <= least:
                    raise
                self._shorten(h, SHRINK)
                limit = 1.0
                continue
            made, passed = self._made(steps)
            now = self.stepper.joined.inputs(self.stepper.last.xi), self._outputs(), h
            error = self._eps(made, passed) if self._ecco else self._error(made, passed, now)
            if error > 1.0 and kept is not None and h > least:
                self.stepper.back(kept)
                self._shorten(h, max(SAFETY * error ** (-1.0 / self._order), SHRINK))
                limit = 1.0
                continue
            self._missed += not self._ecco and error > 1.0
            self._exchanged, self._before = self._exchanged + passed, now
            self._power = self._power + MEMORY * (passed / h - self._power)
            self._smallest, self._largest = min(self._smallest, h), max(self._largest, h)
            self._steps += 1
            if self._steps >= self._controller.first:
                self._control(h, max(error, NOTHING), limit)
            if self._again:
                steps = replace(steps, rejected=np.full(len(steps.H), self._rejected - rejected))
            return [end if whole else t + h], steps

    def _eps(self, made: Array, passed: Array) -> float:
        """eps of ECCO."""
        return float(np.sqrt(np.mean((made / (self._rtol * (FLOOR + passed))) ** 2)))

    def _error(self, made: Array, passed: Array, now: tuple[Array, Array, float]) -> float:
        """The largest residual of a junction relative to what is allowed."""
        residual = made if self._makes else np.zeros(len(made))
        (u, y, h), before = now, self._before
        if before is not None:
            slope = 2.0 * h / (h + before[2])
            hidden = h * HIDDEN * np.abs(slope * (u - before[0]) * slope * (y - before[1]))
            residual = residual + np.array([hidden[place].sum() for place in self._ports])
        if self._floor is None:
            self._floor = np.maximum(passed, self._atol)
        level = (self._exchanged + passed + self._floor) * (passed + h * self._power + self._floor)
        return float((residual / (self._rtol * np.sqrt(level) + TINY)).max(initial=0.0))

    def _outputs(self) -> Array:
        """Mean outputs of all members in the last step (nu)."""
        return np.concatenate([m.output() for m in self.stepper.joined.members])

    def _made(self, steps: Steps) -> tuple[Array, Array]:
        """Energy that each junction made, and what passed through it."""
        pairs = steps.pairs[-1]
        made = np.array([abs(pairs[place].sum()) for place in self._junctions])
        return made, np.array([np.abs(pairs[place]).sum() / 2 for place in self._junctions])

    def _shorten(self, h: float, factor: float) -> None:
        """The trial of length h is rejected."""
        self._rejected, self._h = self._rejected + 1, max(h * factor, self._min_step)

    def _control(self, h: float, error: float, limit: float) -> None:
        """The next size; a step cut short by `end` does not lower it."""
        r = self._controller
        factor = r.safety * error**-r.integral * self._last**r.proportional
        proposal = h * min(max(factor, r.least), limit)
        cut = self._h if h < self._h and factor >= 1.0 else 0.0
        self._h, self._last = min(max(proposal, cut, self._min_step), self._max_step), error


def _ports(stepper: Coupled, junctions: Iterable[str]) -> list[Array]:
    """By junction, places of its ports among the inputs of all members."""
    joined, at = stepper.joined, dict[tuple[str, str], Any]()
    for m, place in zip(joined.members, joined.places, strict=True):
        at |= {(m.name, port): np.arange(own.start, own.stop) + place.start for port, own in m.places.items()}
    ends = {j.name: j.ends for j in joined.network.junctions}
    return [np.concatenate([at[e.member, e.port] for e in ends[n]]) for n in junctions]


def _ecco_fits(stepper: Stepper) -> Coupled:
    """The stepper of a coupling whose junctions make energy."""
    if not isinstance(stepper, Coupled) or stepper.solves_rows:
        once = " or ".join(row.name for row in COUPLINGS.values() if row.apart and not solves_rows(row.kind))
        raise ValueError(f"--ecco follows the energy that junctions make; add --coupling {once}, or leave it out")
    return stepper


def _fits(stepper: Stepper) -> Coupled:
    """The stepper of members that exchange held values at junctions."""
    if not isinstance(stepper, Coupled):
        names = ", ".join(row.name for row in COUPLINGS.values() if row.apart)
        raise ValueError(
            f"--energy-rtol follows the energy that members exchange over a step, and this run steps {stepper.what}, "
            f"which exchanges none: take --rtol, or step members apart (--coupling {names})"
        )
    if not stepper.joined.network.junctions:
        raise ValueError(
            f"--energy-rtol follows the energy at junctions, and {stepper.joined.network.name} has none; leave it out"
        )
    if stepper.coupling.order > 2:
        raise ValueError(
            f"--energy-rtol follows what held values lose, and these members exchange values at the nodes of steps, of order "
            f"{stepper.coupling.order}: take equal steps, or --order 2, or --rtol with --coupling monolithic"
        )
    if stepper.lands:
        raise ValueError("--energy-rtol does not go with steps that end on state events of all members; leave it out")
    return stepper
