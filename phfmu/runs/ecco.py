"""Steps whose size follows the energy that junctions make (ECCO): for couplings that step members once.

With dE_k the energy that junction k made in a step, E_k what passed through it and N junctions,

    eps = sqrt(1/N sum_k (dE_k / (tol (1 J + E_k)))^2),       h <- h s eps^(-kI - kP) eps_last^kP,

within [R_MIN, R_MAX] times the last step.  No step is taken back.  The energies are those of the ledger, not end-point powers.

Source: Sadjina, Kyllingstad, Skjong, Pedersen, Engineering with Computers 33 (2017) 607; s, kI, kP as in libcosim.
"""

from __future__ import annotations

import math

import numpy as np

from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.coupling_table import COUPLINGS
from phfmu.network.couplings.stepper import Stepper
from phfmu.outcome.steps import Steps
from phfmu.runs.options import Options

SAFETY, INTEGRAL, PROPORTIONAL = 0.8, 0.15, 0.2
R_MIN, R_MAX = 0.2, 1.5
FIRST = 2  # the size changes from this step on
NOTHING = 1e-12  # eps below this is this


class Ecco:
    """Steps of a `Coupled`; none is rejected.  ValueError for couplings whose junctions make no energy."""

    CARRIED = ("_h", "_last", "_steps", "_smallest", "_largest")

    def __init__(self, stepper: Stepper, options: Options, tolerance: float):
        if not isinstance(stepper, Coupled) or stepper.coupling.repeats:
            once = " or ".join(row.name for row in COUPLINGS.values() if row.apart and not row.kind.repeats)
            raise ValueError(f"--ecco follows the energy that junctions make; add --coupling {once}, or leave it out")
        self.stepper, self._tolerance = stepper, tolerance
        self._min_step, self._max_step = options.min_step, options.max_step
        self._h, self._last, self._steps = min(options.step, self._max_step), 1.0, 0
        self._smallest, self._largest = math.inf, 0.0
        self._junctions = list(stepper.booking.junctions.values())

    def after_event(self) -> None:
        """Forget the last error: what comes is not its continuation."""
        self._last = 1.0

    def facts(self) -> dict[str, float]:
        """Rejected trials, smallest and largest step (s)."""
        return {"rejected": 0, "smallest": self._smallest, "largest": self._largest}

    def march(self) -> None:
        """Members are stepped one by one: there is no compiled loop."""

    def advance(self, t: float, end: float, restart: bool = False) -> tuple[list[float], Steps]:
        """One step from t, not beyond `end`: where it ends (`end` to the last bit), and the step."""
        left = end - t
        whole = self._h >= left * (1 - 1e-9)
        h = left if whole else self._h if 2 * self._h <= left else left / 2
        steps = self.stepper.advance(t, h, 1)
        self._smallest, self._largest = min(self._smallest, h), max(self._largest, h)
        self._steps += 1
        if self._steps >= FIRST:
            self._control(h, self.error(steps))
        return [end if whole else t + h], steps

    def error(self, steps: Steps) -> float:
        """eps of a step."""
        pairs = steps.pairs[-1]
        made = np.array([pairs[place].sum() for place in self._junctions])
        passed = np.array([np.abs(pairs[place]).sum() / 2 for place in self._junctions])
        return max(float(np.sqrt(np.mean((made / (self._tolerance * (1.0 + passed))) ** 2))), NOTHING)

    def _control(self, h: float, eps: float) -> None:
        """The next size; a step cut short by `end` does not lower it."""
        factor = SAFETY * eps ** (-INTEGRAL - PROPORTIONAL) * self._last**PROPORTIONAL
        proposal = h * min(max(factor, R_MIN), R_MAX)
        cut = self._h if h < self._h and factor >= 1.0 else 0.0
        self._h, self._last = min(max(proposal, cut, self._min_step), self._max_step), eps
