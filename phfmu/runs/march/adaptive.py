"""Steps of a size that keeps an error tolerance.

Each span is taken twice from the same state: with the scheme itself (order p = 2k) and with Radau IIA on as many
nodes (order 2k - 1).  The difference of the states is O(h^2k) and sees what rings; the multipliers, which converge more
slowly and belong to other instants, stay out of it.  Accepted is the scheme's own state, so the power balance of
each step is as exact as ever: it holds for any step size, and no step needs the size of another.

Two-level schemes take a span in two halves, which are accepted, and in one step.  The difference of both, divided by 2^p - 1, is
the error of the halves, O(h^(2k + 1)); it sees what rings too, since k is odd: one step turns the sign of what is fast, two do
not.  The companion is another instance of the same model, with its fast solver.

The error of n = O(1/h) steps is then O(h^2k), in proportion to the tolerance.  Where the accepted state is the one of
lower order (Radau IIA, Itoh-Abe; p < q = order of the estimate), steps keep tolerance^(q/p), which restores that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.discretise.model import Model
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.outcome.limits import defined
from phfmu.outcome.status import Status, StepFailure
from phfmu.outcome.steps import Steps
from phfmu.runs.march.restart import gains
from phfmu.runs.options import Options
from phfmu.schemes.collocated import Collocated
from phfmu.schemes.radau import Radau
from phfmu.terms.bare import Remedy

if TYPE_CHECKING:
    from phfmu.runs.march.native_march import NativeMarch

Array = NDArray[np.float64]

_LIMITS = defined(Path(__file__).parent / "runtime" / "march.h")
SAFETY, SHRINK, GROW = _LIMITS["SAFETY"], _LIMITS["SHRINK"], _LIMITS["GROW"]
INTEGRAL, PROPORTIONAL, LEAST_ERROR = _LIMITS["INTEGRAL"], _LIMITS["PROPORTIONAL"], _LIMITS["LEAST_ERROR"]
DIGITS, NEAR, LOST, TINY = int(_LIMITS["DIGITS"]), _LIMITS["NEAR"], _LIMITS["LOST"], _LIMITS["TINY"]


class ToleranceMissed(StepFailure):
    """The smallest step still misses the tolerance: by how much, in which state, and what may help."""

    def __init__(self, component: str, time: float, h: float, error: float, name: str, advice: str):
        super().__init__(Status.NO_CONVERGENCE, component, time, h)
        self.error, self.name, self.advice = error, name, advice

    def _text(self) -> str:
        return (
            f"{self.component} at t = {self.time:.9g} s: a step of {self.h:.3g} s misses the tolerance {self.error:.3g} times, "
            f"worst state {self.name}, and no smaller one is allowed. Next: {self.advice}"
        )


@dataclass
class ControllerState:
    """The state of the controller from step to step.

    `h`: the proposal;  `last`: error of the last accepted step;  `rejected`: trial steps that were taken back;  `smallest`,
    `largest`: sizes of accepted steps.
    """

    h: float
    last: float = 1.0
    rejected: int = 0
    smallest: float = math.inf
    largest: float = 0.0


class Adaptive:
    """Error-controlled steps of a `Monolithic`: |error_i| <= rtol |x_i| + atol nominal_i per step."""

    CARRIED = ("other", "control")

    def __init__(self, stepper: Monolithic, options: Options, rtol: float):
        self.stepper = stepper
        model = stepper.model
        _require_held(model)
        k, lossy, p = model.step.k, model.loses_energy, model.scheme.order
        #: equal steps of a span, and the part of the difference that is their error
        self.parts, self.share = (2, 1.0 / (2**p - 1)) if model.scheme.two_level else (1, 1.0)
        self.other = stepper.measuring(model.scheme if self.parts > 1 else Collocated(k) if lossy else Radau(k))
        self.order = min(p, self.other.model.scheme.order) + 1
        power = max(1.0, self.order / model.scheme.order)
        self.rtol, self.atol = rtol**power, (rtol if options.atol is None else options.atol) ** power
        self.min_step, self.max_step = self.parts * options.min_step, self.parts * options.max_step
        states = model.declaration.states
        self.nominal = np.array([v.nominal[j] for v in states for j in range(v.n)])
        self._names = [n for v in states for n in v.names()]
        self.control = ControllerState(_rounded(min(self.parts * options.step, self.max_step)))

    def after_event(self) -> None:
        """Forget the last error: what comes is not its continuation."""
        self.control.last = 1.0

    def facts(self) -> dict[str, float]:
        """Rejected trials, smallest and largest step (s)."""
        c = self.control
        return {"rejected": c.rejected, "smallest": c.smallest, "largest": c.largest}

    def notes(self) -> list[str]:
        """Steps that keep the tolerance have none."""
        return []

    def march(self, pauses: bool = False) -> NativeMarch | None:
        """The march of these steps in compiled code, many a call and recorded; None where only a loop in Python can take them.

        `pauses`: it hands over after each state event.
        """
        from phfmu.runs.march.native_march import NativeMarch

        return NativeMarch(self, pauses) if NativeMarch.fits(self) else None

    def advance(self, t: float, end: float, restart: bool = False) -> tuple[list[float], Steps]:
        """The accepted steps of one span from t, not beyond `end`: where they end (`end` to the last bit), and the steps.

        `restart`: accept the damping solution of the pair (see `restart.py`) unless it would gain energy.
        ToleranceMissed, StepFailure: the stepper is at t.
        """
        own, n, taken = self.stepper.instance, self.parts, list[tuple[Steps | None, Steps]]()

        def take(h: float, spent: list[float]) -> None:
            damped, used = self._companion_step(t, h, restart)
            spent.append(used)
            steps = self.stepper.taken(own, t, h / n, n)
            spent.append(steps.spent)
            taken[:] = [(damped, steps)]

        h, goal, spent = self._accepted(t, end, take)
        damped, steps = taken[0]
        if damped is not None and not gains(damped):
            self.stepper.follow(own, self.other)
            steps = damped
        iterations = np.zeros(n) if steps.iterations is None else np.array(steps.iterations)
        iterations[0] = spent - iterations[1:].sum()
        return [*(t + i * (h / n) for i in range(1, n)), goal], replace(steps, iterations=iterations)

    def sized(self, t: float, end: float) -> tuple[float, float, float]:
        """Length and end of one span from t, and its iterations; guards are not looked at, and nothing is recorded.

        The stepper is at t again.
        """
        own, n = self.stepper.instance, self.parts
        before = own.get_state()

        def take(h: float, spent: list[float]) -> None:
            self.other.continue_from(own)
            for instance, parts in ((self.other, 1), (own, n)):
                count = instance.counts["iterations"]
                for i in range(parts):
                    instance.step_exactly(t + i * (h / parts), h / parts)
                spent.append(float(instance.counts["iterations"] - count))

        found = self._accepted(t, end, take)
        own.restore(before)
        return found

    def _accepted(self, t: float, end: float, take: Callable[[float, list[float]], None]) -> tuple[float, float, float]:
        """A span that `take` takes twice, shorter ones until the tolerance is met: its length, where it ends, all iterations."""
        own, spent = self.stepper.instance, list[float]()
        state, before, limit = own.get_state(), own.x, GROW
        while True:
            h, goal = self._fitted(t, end)
            try:
                take(h, spent)
            except StepFailure as failure:
                own.set_state(state)
                self._shrink(t, h, SHRINK, failure)
                continue
            error, worst = self._error(before, own.x)
            if error <= 1.0:
                self._grow(h, error, limit)
                return h, goal, sum(spent)
            own.set_state(state)
            self._shrink(t, h, max(SHRINK, SAFETY * error ** (-1.0 / self.order)), self.missed(t, h, error, worst))
            limit = 1.0

    def missed(self, t: float, h: float, error: float, worst: int) -> ToleranceMissed:
        """A step that misses the tolerance `error` times, in the state number `worst`."""
        return ToleranceMissed(self.stepper.model.name, t, h / self.parts, error, self._names[worst], self._advice(t))

    def _companion_step(self, t: float, h: float, wanted: bool) -> tuple[Steps | None, float]:
        """The trial of the other scheme, its rows if wanted, and its iterations."""
        self.stepper.follow(self.other, self.stepper.instance)
        if wanted and self.other.model.loses_energy:
            steps = self.stepper.taken(self.other, t, h, 1)
            return steps, steps.spent
        count = self.other.counts["iterations"]
        self.stepper.step_unrecorded(self.other, t, h)
        return None, float(self.other.counts["iterations"] - count)

    def _fitted(self, t: float, end: float) -> tuple[float, float]:
        """The proposed size, or what is left up to `end`; half of that if less than two steps are."""
        left = end - t
        h = self.control.h
        if h >= left * (1 - NEAR):
            return left, end
        h = h if 2 * h <= left else _rounded(left / 2)
        return h, t + h

    def _error(self, before: Array, x: Array) -> tuple[float, int]:
        """Largest difference of the two solutions relative to its tolerance, and the state it belongs to."""
        if not x.size:
            return 0.0, 0
        size = np.maximum(np.abs(before), np.abs(x))
        ratio = self.share * np.abs(x - self.other.x) / (self.rtol * size + self.atol * self.nominal)
        worst = int(np.argmax(ratio))
        return float(ratio[worst]), worst

    def _advice(self, t: float) -> str:
        """Advice that is true for this model and its limits."""
        lower = ", lower --min-step" if self.min_step > _least(t) else ""
        jump = "" if self.stepper.model.declaration.constraints or self.stepper.model.loses_energy else (
            ", or take restart steps (--restart) if the state jumps at an event"
        )  # fmt: skip
        return f"loosen --rtol or --atol{lower}{jump}"

    def _shrink(self, t: float, h: float, factor: float, reason: Exception) -> None:
        """A smaller proposal; `reason` is raised if the step is as small as it may be."""
        if h <= max(self.min_step, _least(t)) * (1 + NEAR):
            raise reason
        self.control.rejected += 1
        self.control.h = _rounded(max(factor * h, self.min_step))

    def _grow(self, h: float, error: float, limit: float) -> None:
        """The next proposal by the PI controller; a step cut short by `end` does not lower it."""
        control, error = self.control, max(error, LEAST_ERROR)
        factor = SAFETY * error ** (-INTEGRAL / self.order) * control.last ** (PROPORTIONAL / self.order)
        proposal = h * min(limit, max(SHRINK, factor))
        cut = control.h if h < control.h and limit > 1 else 0.0
        control.h = _rounded(min(max(proposal, cut, self.min_step), self.max_step))
        control.last = error
        control.smallest = min(control.smallest, h / self.parts)
        control.largest = max(control.largest, h / self.parts)


def _require_held(model: Model) -> None:
    """DeclarationError if the scheme lets a hidden constraint chatter: that error does not shrink with the step."""
    scheme = model.scheme
    if not model.checks or model.loses_energy or scheme.two_level:
        return
    fit = "two-level" if model.declaration.constraints else "radau"
    free = [model.checks[0].name] if fit == "two-level" else _free_nodes(model)
    if free:
        raise DeclarationError(
            model.name,
            f"scheme {scheme.name} lets {free[0]} chatter from step to step, whatever their size",
            f"adaptive steps need --scheme {fit} here",
            "drift",
        )


def _free_nodes(model: Model) -> list[str]:
    """Bare nodes without impulses."""
    from phfmu.terms.bare import bare_nodes
    from phfmu.terms.extraction.extract import extract

    held = model.scheme.impulses
    return [n.name for n in bare_nodes(extract(model.declaration)) if not held or n.remedy is Remedy.NONE]


def _least(t: float) -> float:
    """A step that is not lost in the rounding of t."""
    return max(LOST * abs(t), TINY)


def _rounded(h: float) -> float:
    """h rounded down to DIGITS binary digits."""
    mantissa, exponent = math.frexp(h)
    return math.ldexp(math.floor(math.ldexp(mantissa, DIGITS)), exponent - DIGITS)
