"""State events that are refused."""

from __future__ import annotations

from collections.abc import Sequence

from phfmu.engine.limits import LIMITS
from phfmu.engine.status import Status, StepFailure

#: why, in the order of `ph_event_reason` in runtime/events/events.h, and of modes in `switched.py`: what is
#: wrong, and the next move
REASONS = (
    (
        "the jumps of {names} depend on each other (S is singular)",
        "let one of them act where they meet, events that close a loop have no unique impulse",
    ),
    ("{names} would jump with |c| = {value:.6g}, more than its most = {limit:.6g}", "let it jump later, or allow more"),
    (
        "the jumps of {names} together gain {value:.6g} J: their restitutions differ",
        'give events that happen together one restitution, or let contacts push only (Jump(law="unilateral"))',
    ),
    (
        f"{int(LIMITS['MOST_EVENTS'])} events fall into one step, the last {{names}}",
        "declare what holds where they come to rest (StateEvent(rest=..), a Switch with a restitution has it), or give a relay a "
        "hysteresis",
    ),
    (
        "{names} happens again at the same instant, after each event was tried",
        "let the guards of its modes exclude each other: `when` of each, and what it sets",
    ),
    (
        f"{int(LIMITS['MOST_EVENTS'])} events fall into one step, at one instant, the last {{names}}: each drives the state back "
        "over a guard, where it would bounce without end or slide along (Coulomb friction, a relay without hysteresis)",
        "declare what holds where a bounce comes to rest (StateEvent(rest=..), a Switch with a restitution has it); sliding "
        "has no mode: round the force off (F tanh(v/v0) for F sign(v)), give a relay a hysteresis",
    ),
    (
        "after {names} no mode of the switches obeys their laws",
        "give the current that is cut a way to go (a diode beside a switch), or a source an impedance",
    ),
    (
        "{names} opens where its share of least norm is 0, but could hold up to {value:.6g}: the switches depend on each other, "
        "and what holds is not determined",
        "leave one of them out, or give them a stiffness (a resistance), which says what each takes",
    ),
    (
        "the jump of {names}, {value:.6g} J, moves what a junction ties to other members (a rigid link, a node of inductors), "
        "and no impulse reaches those that are stepped apart",
        "compose the network (--coupling monolithic), or make one member of what jumps together",
    ),
)
#: place of the last, which only members have
ACROSS = len(REASONS) - 1


class EventRefused(StepFailure):
    """A state event that cannot happen; `guards` are its names, `reason` its place in REASONS."""

    def __init__(self, component: str, t: float, reason: int, guards: Sequence[str], value: float, limit: float):
        super().__init__(Status.EVENT, component, t, 0.0)
        self.guards, self.reason, self.value, self.limit = tuple(guards), reason, value, limit

    def _text(self) -> str:
        what, advice = REASONS[self.reason]
        names = ", ".join(f"'{g}'" for g in self.guards)
        return (
            f"{self.component} at t = {self.time:.9g} s: {what.format(names=names, value=self.value, limit=self.limit)}. "
            f"Next: {advice}."
        )
