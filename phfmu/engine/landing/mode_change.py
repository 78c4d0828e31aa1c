"""The mode that follows at an event, and how it is entered; the twin of runtime/modes/modes.c."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import NDArray

from phfmu.engine.landing.event_jump import MOST, NO_MODE, SHARED
from phfmu.events.comply import Wanted, could_hold, select
from phfmu.events.modes import Mode, Modes
from phfmu.events.switch_system import At
from phfmu.outcome.status import EventRefused

Array = NDArray[Any]

#: a multiplier that a landed opening leaves, as a part of its typical magnitude: rounding
LANDED = 1e-6


@dataclass(frozen=True)
class Decision:
    """The `mode` with its parameters p and the states x after the impulses that it asks for; `energy` that components get (J)."""

    mode: Mode
    p: Array
    x: Array
    energy: Array


def decide(name: str, modes: Modes, present: Mode, at: At, h: float) -> Decision:
    """At an instant, with the modes that are asked for in at.p; h: step of the run.  EventRefused names the switches."""
    system, switches = modes.system, modes.switches
    proposal: Mode = tuple(int(at.p[i]) for i in system.places)
    fixed = frozenset(j for j, m in enumerate(proposal) if m != present[j])
    shared = could_hold(modes, present, proposal, at.a)
    if shared is not None:
        raise EventRefused(name, at.t, SHARED, [switches[shared.switch].name], shared.most, 0.0)
    # what the steps left of the constraints of the old mode would decide in the new one
    left = system.enter(replace(at, p=system.in_mode(at.p, present))) if fixed else None
    here = at if left is None else replace(at, x=left.x)
    mode = select(modes, here, h, Wanted(present, proposal, fixed))
    if mode is None:
        names = [switches[j].name for j in sorted(fixed)] or [s.name for s in switches]
        raise EventRefused(name, at.t, NO_MODE, names, 0.0, 0.0)
    p = system.in_mode(at.p, mode)
    entry = system.enter(replace(here, p=p))
    for j, s in enumerate(switches):
        cut = abs(float(at.a[system.multipliers[j]]))
        if present[j] and not mode[j] and cut > s.most + LANDED * s.multiplier.nominal[0]:
            if entry.impulse.any() and entry.lost > 0.0:
                raise EventRefused(name, at.t, MOST, [s.name], cut, s.most)
    return Decision(mode, p, entry.x, entry.energy if left is None else entry.energy + left.energy)
