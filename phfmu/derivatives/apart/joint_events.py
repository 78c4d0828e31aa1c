"""State events of members that land together: instants and jumps of the composed declaration, which members are at an instant.

In steps members are apart, at an instant they are one: guards and jumps are derived at the states of all members, in the order of
the composed declaration, as those of a composed model are (`event_maps.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import IndependentVariables
from phfmu.derivatives.event_maps import EventInstant, EventMaps
from phfmu.derivatives.plan_function import PlanFunction
from phfmu.discretise.model import Model
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.members.engine_member import EngineMember

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointOccurrence:
    """Numbers of the state events at one instant, and of those that came to rest."""

    t: float
    events: tuple[int, ...]
    rests: tuple[int, ...]


class JointEvents:
    """Derivatives at the instants of events of `members`, which `model` is composed of; lander: what lands them."""

    def __init__(
        self,
        model: Model,
        joined: CoupledMembers,
        members: Sequence[EngineMember],
        lander: Any,
        by: IndependentVariables,
    ):
        assert model.events is not None
        self._model, self._joined, self._members, self._by = model, joined, members, by
        self.lander = lander
        self.maps = EventMaps(model, model.events, by.directions)
        #: of guards
        self.names: Sequence[str] = model.events.names
        #: events of the run so far
        self.met = list[JointOccurrence]()
        self._algebraics = PlanFunction(model.instant, lambda rows: rows.algebraics, by.directions, moves=True)
        self._places = [slice(a, b) for a, b in pairwise(np.cumsum([0, *(m.model.step.nx for m in members)]).tolist())]
        names = [n for v in model.declaration.algebraics for n in v.names()]
        self._junctions = np.array([names.index(n) for n in joined.face.names], int)

    def now(self) -> EventInstant:
        """The common instant of all members."""
        x, p = (np.concatenate([getattr(m.instance, n) for m in self._members]) for n in ("x", "parameters"))
        a, t = self.lander.algebraics, float(self._members[0].instance.time)
        free = self._joined.free[self._joined.face.column < 0]
        return EventInstant(t, x, self._model.a0.copy() if a is None else a, free, p)

    def happened(self, t: float) -> JointOccurrence:
        """The events that happened last."""
        events, rests = self.lander.last
        self.met.append(JointOccurrence(t, tuple(events), tuple(rests)))
        return self.met[-1]

    def anew(self, member: EngineMember) -> bool:
        """Whether a member began anew with the last event, so that its means are those of the instant."""
        return member.name in self.lander.anew

    def landed(
        self, events: Sequence[int], at: EventInstant, S: list[Array], rate: list[Array], grid: float, acts: Array
    ) -> Array:
        """Tangent (names) of the end of a step, where guards are zero: from those of the states of members for a given end (nx x
        names), and their rates by it (nx); grid: length of steps that do not land.  NoDerivative."""
        all_, by_end, found = np.concatenate(S), np.concatenate(rate), []
        for i in events:
            g = self.maps.guard(i, at)
            own = float(g.x @ by_end) + g.t
            self.maps.require_crossing(i, at.t, own, grid)
            found.append(-(g.x @ all_ + self._by.spread(g.along) * acts) / own)
        self.maps.require_together(at.t, events, np.array(found), self._by.sizes(at.x, at.u, at.p))
        return found[0]

    def jumped(
        self, met: JointOccurrence, before: EventInstant, p: Array, S: list[Array], T: Array, acts: Array
    ) -> list[Array]:
        """Tangents of the states of members after a jump, with the parameters p after it."""
        at = EventInstant(before.t, before.x, before.a, before.u, p)
        jump, all_ = self.maps.jump(met.events, met.rests, at), np.concatenate(S)
        if jump is not None:
            all_[jump.moved] += jump.x @ all_ + np.outer(jump.t, T) + self._by.spread(jump.along) * acts
        return [all_[place] for place in self._places]

    def junctions(self, at: EventInstant, S: list[Array], T: Array, acts: Array) -> Array | None:
        """Tangents of the junction unknowns at an instant, where members take those of the composed declaration."""
        if self.lander.algebraics is None:
            return None
        plan, d = self._model.instant, self._by.directions
        args = np.array([at.t]), at.x[None], at.u[None], at.p, at.a[None]
        found = self._algebraics.at_instants(*args)[0][self._junctions]
        ahead = plan.nx + d.n
        own = found[:, : plan.nx] @ np.concatenate(S) + self._by.spread(found[:, plan.nx : ahead]) * acts
        return own + np.outer(found[:, ahead], T)
