"""Members of order 2k that land together: all end their steps where a guard of one of them is zero.

The polynomials of node values do not reach over an event, so a step of all members is tried, the guards are looked at on the
polynomials of their members, and the step that ends on the first zero of all is taken by all, with an iteration of the interface
for each trial.  Rules and words are those of `engine/landing/locate.py`, which sees one instance with the states of all
such members.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.landing.event_jump import Guards
from phfmu.engine.landing.grid_step import grid_step
from phfmu.engine.landing.landing import Landing
from phfmu.engine.landing.locate import Location
from phfmu.events.event_plan import EventPlan, Settings
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.joint_impulse import FiredEvents
from phfmu.network.interface.shared_jumps import SharedJumps
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.event_texts import EventTexts
from phfmu.outcome.steps import StepEvent

Array = NDArray[Any]


_NONE: frozenset[int] = frozenset()


class CoupledLander:
    """Steps of `members` with state events and of all they are joined with.

    joined: all members of the network;  shared: which jumps act on several
    solve: takes a step (t, h) of all, True if in one part;  save, restore: of where all are
    """

    CARRIED = ("location",)
    #: algebraic variables of the composed declaration, which members that land like this are not asked for
    algebraics = None

    def __init__(
        self,
        joined: CoupledMembers,
        shared: SharedJumps,
        members: list[EngineMember],
        solve: Callable[[float, float], bool],
        save: Callable[[], Any],
        restore: Callable[[Any], None],
    ):
        self.members, self._joined, self._shared, self._solve = members, joined, shared, solve
        for m in members:
            m.together = True
        self._save, self.restore, self._saved, self._in_parts = save, restore, save(), 0
        self._landings = [Landing(m.instance) for m in members]
        self._words = [EventTexts(m.model, m.name) for m in members]
        plans = [m.model.events for m in members]
        self._plan = _StackedGuards(members, [p for p in plans if p is not None])
        k = max(m.model.step.k for m in members)
        #: numbers of the events that happened last and of those that came to rest, among the guards of all members
        self.last: tuple[list[int], list[int]] = [], []
        #: names of the members that began anew with them, whose means are those of the instant
        self.anew: set[str] = set()
        self.model = SimpleNamespace(step=SimpleNamespace(k=k, na=0))
        self.location: Any = Location(self, self._plan, self._plan)  # type: ignore[arg-type]

    # -- an instance ----------------------------------------------------------------------------------------------------

    @property
    def x(self) -> Array:
        return np.concatenate([m.instance.x for m in self.members])

    @property
    def unknowns(self) -> Array:
        return np.concatenate([m.instance.unknowns for m in self.members])

    @property
    def parameters(self) -> Array:
        return np.concatenate([m.instance.parameters for m in self.members])

    @property
    def held_input(self) -> Array:
        """Guards that read inputs do not land together."""
        return np.zeros(0)

    @property
    def time(self) -> float:
        return float(self.members[0].instance.time)

    @property
    def counts(self) -> dict[str, int]:
        """Number of steps that were halved, by members or by all: such a step has no polynomial."""
        return {"substeps": self._in_parts + sum(m.instance.counts["substeps"] for m in self.members)}

    def step_exactly(self, t: float, h: float) -> None:
        self._in_parts += not self._solve(t, h)

    def get_state(self) -> Any:
        self._saved = self._save()
        return self._saved

    def back(self) -> None:
        """To where the last step began."""
        self.restore(self._saved)

    # -- a grid step ----------------------------------------------------------------------------------------------------

    def over(
        self, t: float, end: float, changed: bool, pause: bool = False
    ) -> Iterator[tuple[float, float, StepEvent | None]]:
        """(start, length, None) of each step taken in [t, end], (time, 0, what happened at members) of each event.

        `pause`: ends after the first event, and those that follow it at the same time.
        """
        for landing in self._landings:
            landing.begin()
        fired = self.location.begun(t, end - t) if changed else []
        yield from grid_step(self, t, end, end - t, fired, pause=pause)

    @property
    def guards(self) -> int:
        return self._plan.n

    def refuse_again(self, t: float, fired: list[int]) -> NoReturn:
        member, own = next(self._plan.of(fired))
        self._landings[member].refuse_again(t, own)

    def happen(self, t: float, h: float, fired: list[int], events: int) -> StepEvent:
        before = self.get_state()
        try:
            return self._happened(t, h, fired, events)
        except BaseException:
            self.restore(before)
            raise

    def _happened(self, t: float, h: float, fired: list[int], events: int) -> StepEvent:
        """Events of members at once, as one event."""
        own = dict(self._plan.of(fired))
        decided = {i: self._landings[i].decided(t, h, numbers, events) for i, numbers in own.items()}
        struck, (energy, lost) = self._struck(t, own, decided)
        self.anew |= {self.members[i].name for i in own}
        self.last = fired, self._plan.numbers({i: rests for i, (_, rests) in decided.items()})
        told = list[StepEvent]()
        for i, (p, rests) in decided.items():
            landing, of = self._landings[i], self._joined.components(self.members[i].name)
            if i not in struck:
                energy[of], lost[of] = landing.jumps.jump(t, p, own[i], rests)
            happened = landing.follows(t, h, (p, own[i], rests), (energy[of], lost[of]))
            told.append(self._words[i].told(happened))
        names, messages = ", ".join(e.names for e in told), "; ".join(e.message for e in told)
        return StepEvent(t, energy, lost, names, messages)

    def _struck(
        self, t: float, own: dict[int, list[int]], decided: dict[int, tuple[Array, list[int]]]
    ) -> tuple[set[int], Any]:
        """Members whose jumps have taken place, in one system with all that these act on; energies got and lost by component."""
        numbers = [self._joined.members.index(m) for m in self.members]
        start = [
            numbers[i] for i, e in own.items() if not self._shared.of.get(self.members[i].name, _NONE).isdisjoint(e)
        ]
        self.anew = set()
        if not start:
            return set(), np.zeros((2, len(self._joined.booking.components)))
        reached, _ = self._shared.reached(start)
        self.anew = {self._joined.members[i].name for i in reached}
        struck = {i for i in own if numbers[i] in reached}
        fired = {numbers[i]: FiredEvents(self._landings[i].plan, own[i], *decided[i]) for i in struck}
        return struck, self._shared.jump(t, fired)


class _StackedGuards:
    """The guards of all members as those of one plan: x = [states of each | t], p = [parameters of each]."""

    solves = 0

    def __init__(self, members: list[EngineMember], plans: list[EventPlan]):
        self._plans, self._guards = plans, [Guards(p) for p in plans]
        steps = [m.model.step for m in members]
        self._first = np.cumsum([0, *(p.n for p in plans)])
        self._x, self._w, self._p = (
            np.cumsum([0, *(getattr(s, size) for s in steps)]).tolist() for size in ("nx", "nw", "np")
        )
        self._y = [np.zeros(s.na + s.nu) for s in steps]
        self.n = int(self._first[-1])
        self.rated = np.concatenate([(p.rated != 0) & ~_reads(p) for p in plans])
        self.direction = np.concatenate([p.direction for p in plans])
        self.nominal = np.concatenate([p.nominal for p in plans])
        self.when, self.sets = (self._settings([getattr(p, name) for p in plans]) for name in ("when", "sets"))

    def _settings(self, own: list[Settings]) -> Settings:
        ends = np.cumsum([0, *(len(s.p) for s in own)])
        ptr = [s.ptr[:-1] + at for s, at in zip(own, ends, strict=False)]
        places = [s.p + at for s, at in zip(own, self._p, strict=False)]
        return Settings(
            np.append(np.concatenate(ptr), ends[-1]), np.concatenate(places), np.concatenate([s.value for s in own])
        )

    def of(self, fired: list[int]) -> Iterator[tuple[int, list[int]]]:
        """Members with their own numbers of the guards `fired`."""
        for i, (a, b) in enumerate(zip(self._first[:-1], self._first[1:], strict=True)):
            if own := [int(j - a) for j in fired if a <= j < b]:
                yield i, own

    def numbers(self, own: dict[int, list[int]]) -> list[int]:
        """The numbers of guards among all, from those of each member."""
        return [int(self._first[i]) + j for i, which in own.items() for j in which]

    def values(self, x: Array, y: Array, p: Array) -> Array:
        """All guards (n)."""
        return self._gathered("values", x, p)

    def _gathered(self, what: str, x: Array, p: Array) -> Array:
        found = [
            getattr(g, what)(np.append(x[a:b], x[-1]), own, p[c:d])
            for g, own, a, b, c, d in zip(
                self._guards, self._y, self._x[:-1], self._x[1:], self._p[:-1], self._p[1:], strict=True
            )
        ]
        return np.concatenate(found)

    def rates(self, x: Array, y: Array, p: Array) -> Array:
        """d guard / dt of all guards (n), 0 of those that are not rated, or whose rates read inputs."""
        return np.where(self.rated, self._gathered("rates", x, p), 0.0)

    def polynomial(self, x: Array, w: Array, tau: float) -> Array:
        """States of all at the fraction tau of a step."""
        return np.concatenate(
            [
                p.polynomial(x[a:b], w[c:d], tau)
                for p, a, b, c, d in zip(self._plans, self._x[:-1], self._x[1:], self._w[:-1], self._w[1:], strict=True)
            ]
        )


def _reads(plan: EventPlan) -> NDArray[np.bool_]:
    """Guards (n) whose rates read inputs, which are not known where members land together."""
    found = np.zeros(plan.n, bool)
    for group in plan.rates:
        found[group.oi.ravel()] |= group.yi.shape[1] > 0
    return found
