"""Held signals that are iterated to agreement: what a step ends with is what it was taken with.

With w the signals at the end of a step of which w_n are those at its start, members take the held values (w_n + w) / 2 over it.
Then their inputs are w, and what they send has to be w as well,

    r(w) = w - factor y(w) - offset = 0.

Of second order where outputs follow states; a loop of outputs that follow inputs at once is solved at the ends of steps.  The
matrix dr/dw is found by differences once, kept from step to step by Broyden's rule, and found anew where it stops contracting.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.coupling import Step, Unconverged
from phfmu.network.couplings.signals.sampled_signals import SampledSignals
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.outcome.status import Status

Array = NDArray[np.float64]
Taken = TypeVar("Taken")

TRIALS = 60  # of a step, those for differences included
AGREED = 1e-10  # |r| relative to the signals
NOISE = 1e-6  # the same where trials no longer come closer: solvers inside units leave so much
SLOW = 0.3  # contraction above which the matrix is found anew
SINGULAR = 1e9  # condition of the scaled matrix, which differences know to some 1e-10
MOVE = 1e-5  # relative change of a signal in differences


@dataclass
class _Trial:
    """Signals and what they leave; `size`: what each is measured by."""

    w: Array
    r: Array
    size: Array

    @property
    def miss(self) -> float:
        return float(np.max(np.abs(self.r) / self.size, initial=0.0))


class SignalsApart:
    """Steps in which signals do not agree, as where one jumps at a threshold: they are taken from the samples, and counted."""

    CARRIED = ("_steps", "_first")

    def __init__(self, signals: SampledSignals):
        self._signals, self._steps, self._first = signals, 0, 0.0

    def take(self, step: Step, xi: Array) -> None:
        """Inputs of the step from the samples at its start."""
        self._signals.set_now(self._signals.now, xi)
        self._signals.hold(step.h, xi)
        self._first = self._first if self._steps else step.t
        self._steps += 1

    def told(self) -> list[str]:
        """A line about them, if there are any."""
        if not self._steps:
            return []
        steps = "1 step" if self._steps == 1 else f"{self._steps} steps, the first"
        return [f"signals did not agree in {steps} at t = {self._first:.6g} s: they were extrapolated there"]


class AgreedSignals:
    """The iteration, for members that all can take steps back."""

    CARRIED = ("_matrix", "_most", "found")

    def __init__(self, joined: CoupledMembers, signals: SampledSignals):
        self._joined, self._signals = joined, signals
        self._matrix: Array | None = None
        self._most = np.zeros(len(signals.held))
        #: the signals that the last step agreed on
        self.found: Array | None = None

    def at_instant(self, xi: Array) -> None:
        """Signals where no step is taken: outputs may follow inputs at once.  As sampled where none agree; xi: of junctions."""
        sampled = self._signals.now
        try:
            found, _ = self._solved(
                sampled, lambda w: (self._signals.sent_under(w, xi), None), Step(0.0, 0.0, []), None
            )
        except Unconverged:
            found = sampled
        self._signals.set_now(found, xi)

    def step(self, step: Step, xi: Array, take: Callable[[Step], Taken], end: Callable[[Taken], Array]) -> Taken:
        """`xi`: junction unknowns of the step before;  `take`: a step of all members from where they are;  `end`: junction
        unknowns at its end.  Unconverged.
        """

        def sent(w: Array) -> tuple[Array, Taken]:
            self._joined.restore(step.states)
            self._signals.hold_towards(w, xi)
            taken = take(Step(step.t, step.h, self._joined.states()))
            return self._signals.sent_under(w, end(taken)), taken

        self.found, taken = self._solved(self._signals.ahead(step.h), sent, step, self._matrix)
        return taken

    def _solved(
        self, w: Array, sent: Callable[[Array], tuple[Array, Taken]], step: Step, matrix: Array | None
    ) -> tuple[Array, Taken]:
        """Signals that agree, and what was taken under them last."""
        trials = 0

        def tried(w: Array) -> tuple[_Trial, Taken]:
            nonlocal trials
            trials += 1
            found, taken = sent(w)
            most = np.maximum(self._most, np.maximum(np.abs(w), np.abs(found)))
            return _Trial(w, w - found, most + (most == 0.0)), taken

        now, taken = tried(w)
        history, fresh = [now.miss], False
        while not now.miss <= AGREED:
            if not np.isfinite(now.r).all():
                raise self._failure(Status.NOT_FINITE, step, now, history)
            if trials >= TRIALS:
                raise self._failure(Status.NO_CONVERGENCE, step, now, history)
            if matrix is None:
                matrix, fresh = self._differences(now, lambda v: tried(v)[0]), True
                if not np.linalg.cond(matrix * now.size / now.size[:, None]) < SINGULAR:
                    raise self._failure(Status.SINGULAR, step, now, history)
            try:
                d = -np.linalg.solve(matrix, now.r)
            except np.linalg.LinAlgError:
                raise self._failure(Status.SINGULAR, step, now, history) from None
            before, (now, taken) = now, tried(now.w + d)
            history.append(now.miss)
            if now.miss > SLOW * before.miss:
                if fresh and now.miss <= NOISE and not now.miss < before.miss:
                    break
                matrix = None if not fresh or now.miss > before.miss else matrix
                fresh = False
            if matrix is not None and np.any(d):
                scaled = d / now.size**2
                matrix = matrix + np.outer(now.r - before.r - matrix @ d, scaled) / (scaled @ d)
        if step.h:
            self._matrix, self._most = matrix, np.maximum(self._most, np.abs(now.w))
        return now.w, taken

    def _differences(self, at: _Trial, tried: Callable[[Array], _Trial]) -> Array:
        columns = []
        for j, size in enumerate(at.size):
            moved = at.w.copy()
            moved[j] += MOVE * size
            columns.append((tried(moved).r - at.r) / (moved[j] - at.w[j]))
        return np.array(columns).T

    def _failure(self, status: Status, step: Step, trial: _Trial, history: list[float]) -> Unconverged:
        worst = int(np.argmax(np.nan_to_num(np.abs(trial.r) / trial.size, nan=np.inf)))
        last = ", ".join(f"{v:.3g}" for v in history[-3:])
        return Unconverged(
            status, self._joined.network.name, step.t, step.h,
            equation=f"signal {self._signals.held[worst]} = {trial.w[worst]:.6g}",
            residual=float(abs(trial.r[worst])), iterations=len(history), history=history, signals=True,
            tried=f"signals iterated to agreement (last misses {last}); all members are back at t",
        )  # fmt: skip
