"""Restart steps: a few Radau IIA steps after an event, so that what is stiff and fast decays instead of ringing.

Gauss nodes multiply a mode that decays within a step by (-1)^k: odd k rings, even k hangs, with a closed ledger.
Radau IIA multiplies it by 0.  What that loses is booked as `numerical`; it is >= 0 for quadratic H.  A step in which
a component would gain instead (other H) is taken by the exact scheme.
"""

from __future__ import annotations

from phfmu.declare.error import DeclarationError
from phfmu.engine.steps import Steps
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.schemes.radau import Radau

#: a gain below this part of the step's energies is rounding
ROUNDING = 1e-12


class Restart:
    """Takes steps of a `Monolithic` with Radau IIA nodes (k = 2, order 3).  DeclarationError if they do not fit."""

    def __init__(self, stepper: Monolithic, k: int = 2):
        require_fit(stepper)
        self.stepper = stepper
        self.instance = stepper.companion(Radau(k))
        #: steps that fell back to the exact scheme
        self.refused = 0

    def advance(self, t0: float, h: float) -> Steps:
        """One step from t0; the stepper's instance goes on from its end."""
        own = self.stepper.instance
        self.stepper.follow(self.instance, own)
        steps = self.stepper.taken(self.instance, t0, h, 1)
        if gains(steps):
            self.refused += 1
            return self.stepper.advance(t0, h, 1)
        self.stepper.follow(own, self.instance)
        return steps


def require_fit(stepper: Monolithic) -> None:
    """DeclarationError if damping steps would let constraints drift."""
    declaration = stepper.model.declaration
    if declaration.constraints:
        raise DeclarationError(
            declaration.name,
            "restart steps let the holonomic constraints drift",
            "take none (--restart 0) and smaller steps after events with --rtol",
            "drift",
        )


def gains(steps: Steps) -> bool:
    """Whether the numerical loss of a component is negative by more than rounding."""
    if steps.numerical is None:
        return False
    size = abs(steps.stored) + abs(steps.dissipated) + abs(steps.supplied)
    return bool((steps.numerical < -ROUNDING * size).any())
