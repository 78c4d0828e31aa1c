"""Members of order 2k that land together: all end their steps where a guard of one of them is zero.

The polynomials of node values do not reach over an event, so a step of all members is tried, the guards are looked at on the
polynomials of their members, and the step that ends on the first zero of all is taken by all, with an iteration of the interface
for each trial.  Compiled code locates the zeros on the members with events side by side, whose steps are lent to it, as units of
coupled members do (as_unit/runtime/network_lander.c).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.within import polynomial_of
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.native_landing import StepCallbacks
from phfmu.network.couplings.coupling import AllSteps
from phfmu.network.couplings.landing.side_by_side import side_by_side, without_inputs
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.joint_impulse import FiredEvents
from phfmu.network.interface.shared_jumps import SharedJumps
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.event_texts import EventTexts
from phfmu.outcome.steps import EventRecord, StepEvent

Array = NDArray[Any]

_NONE: frozenset[int] = frozenset()


class CoupledLander:
    """Steps of `members` with state events and of all they are joined with.

    joined: all members of the network;  shared: which jumps act on several;  steps: of all
    """

    #: algebraic variables of the composed declaration, which members that land like this are not asked for
    algebraics = None

    def __init__(self, joined: CoupledMembers, shared: SharedJumps, members: list[EngineMember], steps: AllSteps):
        self.members, self._joined, self._shared, self._steps = members, joined, shared, steps
        for m in members:
            m.together = True
        self._saved, self._in_parts = steps.save(), 0
        self._words = [EventTexts(m.model, m.name) for m in members]
        model = side_by_side({m.name: m.model for m in members})
        self._whole = NativeInstance(replace(model, events=without_inputs(model)), kernels=members[0].instance.kind)
        self._landing, self._check = self._whole.landing
        self._landing.lend(StepCallbacks(self, self._whole))
        plans = [m.model.events for m in members]
        counts = [p.n for p in plans if p is not None]
        self.guards = sum(counts)
        self._landing.stop_before(np.ones(self.guards, np.int8))
        self._x, self._p, self._components = (
            _places([getattr(m.model.step, size) for m in members]) for size in ("nx", "np", "ncomp")
        )
        self._guards = _places(counts)
        #: numbers of the events that happened last and of those that came to rest, among the guards of all members
        self.last: tuple[list[int], list[int]] = [], []
        #: names of the members that began anew with them, whose means are those of the instant
        self.anew: set[str] = set()

    def get_state(self) -> tuple[bytes, Array]:
        """The state of the model that has those of all, and the rates with which it got there."""
        return self._whole.get_state(), self._landing.rates.copy()

    def set_state(self, state: tuple[bytes, Array]) -> None:
        """Goes on from what `get_state` gave."""
        whole, rates = state
        self._whole.set_state(whole)
        self._landing.rates[:] = rates

    # -- steps of all, lent to the model ------------------------------------------------------------------------------------

    @property
    def halved(self) -> int:
        """Number of steps that were halved, by members or by all: such a step has no polynomial."""
        return self._in_parts + sum(m.instance.counts["substeps"] for m in self.members)

    @property
    def x(self) -> Array:
        return np.concatenate([m.instance.x for m in self.members])

    def step(self, t: float, h: float) -> None:
        self._in_parts += not self._steps.solve(t, h)

    def inside(self, x: Array, tau: float) -> Array:
        found = [
            polynomial_of(m.model)(x[place], m.instance.unknowns, tau)
            for m, place in zip(self.members, self._x, strict=True)
        ]
        return np.concatenate(found)

    def save(self) -> None:
        self._saved = self._steps.save()

    def back(self) -> None:
        """To where the last step began."""
        self._steps.restore(self._saved)

    # -- a grid step --------------------------------------------------------------------------------------------------------

    def over(
        self, t: float, end: float, changed: bool, pause: bool = False
    ) -> Iterator[tuple[float, float, StepEvent | None]]:
        """(start, length, None) of each step taken in [t, end], (time, 0, what happened at members) of each event.

        `pause`: ends after the first event, and those that follow it at the same time.
        """
        self._whole.set_x(t, self.x)
        self._whole.set_parameters(np.concatenate([m.instance.parameters for m in self.members]))
        for start, taken in self._landing.stopping(t, end, changed, pause, self._check):
            yield start, taken, None if taken else self._happened(start)

    def _happened(self, t: float) -> StepEvent:
        """The events that the landing stopped before, at t; members are where they were if they are refused."""
        before = self._steps.save()
        try:
            told = self._jumped(t)
            self._landing.after(self._check)
        except BaseException:
            self._steps.restore(before)
            raise
        return told

    def _jumped(self, t: float) -> StepEvent:
        """Events of members at once, as one event."""
        found = np.zeros((2, len(self._joined.booking.components)))
        fired, rests, p, struck = self._struck(t, found)
        own, still, told = self._of(fired), self._of(rests), list[StepEvent]()
        for i, events in own.items():
            m = self.members[i]
            if i not in struck and _moves(m, events):
                m.instance.set_x(t, self._whole.x[self._x[i]])
            m.instance.set_parameters(p[self._p[i]])
            m.instance.initialise()
        self._whole.set_x(t, self.x)
        self._whole.set_parameters(p)
        self.last = fired, rests
        self.anew |= {self.members[i].name for i in own}
        for i, events in own.items():
            of = self._joined.components(self.members[i].name)
            record = EventRecord(t, tuple(events), tuple(still.get(i, ())), found[0, of], found[1, of], np.zeros(0))
            told.append(self._words[i].told(record))
        names, messages = ", ".join(e.names for e in told), "; ".join(e.message for e in told)
        return StepEvent(t, found[0], found[1], names, messages)

    def _of(self, events: list[int]) -> dict[int, list[int]]:
        """Members with their own numbers of events."""
        own = {i: [e - g.start for e in events if g.start <= e < g.stop] for i, g in enumerate(self._guards)}
        return {i: numbers for i, numbers in own.items() if numbers}

    def _struck(self, t: float, found: Array) -> tuple[list[int], list[int], Array, set[int]]:
        """Events that happen, those that come to rest, the parameters after them, and members whose jumps act on others.

        found: energies got and lost by component of the network.  A jump that acts on other members takes place in one system
        with all that these act on.
        """
        self.anew = set()
        if not any(self._shared.of.get(m.name) for m in self.members):
            self._book(found, self._landing.jump(self._check), set())
            return *self._landing.decided, set()
        self._landing.decide(self._check)
        fired, rests, p = self._landing.decided
        own, still = self._of(fired), self._of(rests)
        numbers = [self._joined.members.index(m) for m in self.members]
        start = [
            numbers[i] for i, e in own.items() if not self._shared.of.get(self.members[i].name, _NONE).isdisjoint(e)
        ]
        reached = self._shared.reached(start)[0] if start else []
        struck = {i for i in own if numbers[i] in reached}
        if len(struck) < len(own):
            self._book(found, self._landing.jump(self._check), struck)
        self.anew = {self._joined.members[i].name for i in reached}
        if start:
            at = {
                numbers[i]: FiredEvents(_events(self.members[i]), own[i], p[self._p[i]], still.get(i, []))
                for i in struck
            }
            found += self._shared.jump(t, at)
        return fired, rests, p, struck

    def _book(self, found: Array, by_component: tuple[Array, Array], others: set[int]) -> None:
        """Energies of the members' own jumps; `others` have jumped elsewhere."""
        for i, m in enumerate(self.members):
            if i not in others:
                of = self._joined.components(m.name)
                found[0, of], found[1, of] = (e[self._components[i]] for e in by_component)


def _places(counts: list[int]) -> list[slice]:
    return [slice(a, b) for a, b in pairwise(np.cumsum([0, *counts]).tolist())]


def _events(m: EngineMember) -> Any:
    return m.model.events


def _moves(m: EngineMember, events: list[int]) -> bool:
    """Whether states may jump with these events of a member."""
    jump = _events(m).jump
    return jump is not None and bool(jump.held or (np.asarray(jump.of)[events] >= 0).any())
