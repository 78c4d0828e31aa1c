"""Restart steps: a few Radau IIA steps after an event, so that what is stiff and fast decays instead of ringing.

After a state event the rest of its step is damped too.

Gauss nodes multiply a mode that decays within a step by (-1)^k: odd k rings, even k hangs, with a closed ledger.
Radau IIA multiplies it by 0.  What that loses is booked as `numerical`; it is >= 0 for quadratic H.  A step in which
a component would gain instead (other H) is taken by the exact scheme.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from phfmu.declare.error import DeclarationError
from phfmu.engine.record import Grid
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.stepper import Landing, Stepper
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import Steps
from phfmu.schemes.radau import Radau

if TYPE_CHECKING:
    from phfmu.network.couplings.coupled import Coupled

#: a gain below this part of the step's energies is rounding
ROUNDING = 1e-12


class Restart:
    """Takes steps of one composed model, or of members stepped apart, with Radau IIA nodes (k = 2, order 3), or of `companion`,
    which damps.

    DeclarationError, or ValueError with the remedies, if they do not fit.
    """

    CARRIED = ("instance", "asked", "refused")

    def __init__(self, stepper: Stepper, k: int = 2, companion: Any = None):
        self.stepper: Any = fitting(stepper)
        self.instance = self.stepper.companion(Radau(k)) if companion is None else companion
        #: steps that were to be damped, and those of them that the exact scheme took
        self.asked, self.refused = 0, 0

    def advance(self, t0: float, h: float) -> Steps:
        """One step from t0; the stepper's instance goes on from its end."""
        own = self.stepper.instance
        self.asked += 1
        self.stepper.follow(self.instance, own)
        steps = self.stepper.taken(self.instance, t0, h, 1)
        if gains(steps):
            self.refused += 1
            return self.stepper.advance(t0, h, 1)
        self.stepper.follow(own, self.instance)
        return steps

    def land(self, t: float, h: float, changed: bool = False, pause: bool = False) -> Iterator[Landing]:
        """A step from t that ends on the zeros of guards too, with the events in it; see `Monolithic.landed`."""
        own, grid, parts, failure = self.stepper.instance, Grid(t, h, 1, pause=pause), list[Landing](), None
        self.asked += 1
        self.stepper.follow(self.instance, own)
        try:
            for part in self.stepper.landed(self.instance, grid, changed):
                parts.append(part)
        except StepFailure as found:
            failure = found
        if any(steps is not None and gains(steps) for _, _, steps, _ in parts):
            self.refused += 1
            yield from self.stepper.landed(own, grid, changed)
            return
        self.stepper.follow(own, self.instance)
        yield from parts
        if failure is not None:
            raise failure

    @property
    def events_inside(self) -> bool:
        """Whether state events happen inside the steps of members, which end at none of them."""
        return not isinstance(self.stepper, Monolithic) and self.stepper.events_inside

    @property
    def taken(self) -> int:
        """Steps that were damped."""
        return self.asked - self.refused

    def notes(self) -> list[str]:
        """A line if some were not damped."""
        return not_damped(self.refused, self.asked)


def not_damped(refused: int, asked: int) -> list[str]:
    """A line if some of the steps that were to be damped were not."""
    if not refused:
        return []
    return [
        f"{refused} of {asked} damping steps after events were taken by the energy-exact scheme: in a Radau step a component "
        "would have gained energy, which it can where H is not quadratic in the states"
    ]


def fitting(stepper: Stepper) -> Monolithic | Coupled:
    """The stepper, if it takes damping steps; DeclarationError if they would let constraints drift, ValueError for others."""
    from phfmu.network.couplings.coupled import Coupled

    if isinstance(stepper, Coupled):
        require_apart(stepper)
        return stepper
    whole = monolithic(stepper, "--restart")
    require_fit(whole)
    return whole


def monolithic(stepper: Stepper, option: str) -> Monolithic:
    """The stepper, if it is one composed model; raises ValueError, with the remedies, if not."""
    if isinstance(stepper, Monolithic):
        return stepper
    raise ValueError(
        f"{option} needs one composed model stepped by the python or native engine, here it is {stepper.what}; "
        f"leave out {option}, or {stepper.instead}"
    )


def require_apart(stepper: Coupled) -> None:
    """Raise ValueError with the remedies for members that take no damping steps."""
    if not (found := stepper.undamped()):
        return
    lines = "; ".join(f"{f'member {name!r}' if name else 'members stepped apart'} {why}" for name, why in found.items())
    raise ValueError(
        f"--restart: {lines}; leave out --restart and take smaller steps after events, or {stepper.instead}"
    )


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
    moved = steps.stored if steps.moved is None else steps.moved
    size = abs(moved) + abs(steps.dissipated) + abs(steps.supplied)
    return bool((steps.numerical < -ROUNDING * size).any())
