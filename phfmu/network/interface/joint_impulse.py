"""One system of the impulses of several members: jumps m, impulses a between members, constraints r within them.

With L_i, c_i, S_i of the jumps, ports and constraints of member i (`engine/port_jumps.py`) and T_i its columns by those of all,
its ports taking s_i = P_i B a,

    S = sum T_i^T S_i T_i,     c = sum T_i^T c_i,     x_i+ = x_i- + L_i T_i (m, a, r),     c+ = c- + S (m, a, r),

c+ = -e c- (or the law of a contact) of jumps, c+ = 0 of the others: the jump of the composed model, with its energies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.event_jump import Laws, struck
from phfmu.engine.port_jumps import JumpKernel
from phfmu.events.event_plan import EventPlan
from phfmu.events.impulse import ImpulseColumns
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.node_values import Offer
from phfmu.outcome.status import EventRefused

if TYPE_CHECKING:
    from phfmu.network.members.fmu_member import FMUMember

Array = NDArray[Any]


@dataclass(frozen=True)
class FiredEvents:
    """Events of a model with the plan `plan` that happen now: parameters after them, and which of them come to rest."""

    plan: EventPlan
    events: list[int]
    p: Array
    rests: list[int]

    @property
    def jumping(self) -> list[int]:
        """Events of them that jump."""
        jump = self.plan.jump
        return [] if jump is None else [e for e in self.events if jump.of[e] >= 0]

    @property
    def jumps(self) -> list[int]:
        """Numbers of these among the jumps of the model."""
        jump = self.plan.jump
        return [] if jump is None else jump.of[self.jumping].tolist()


class Party(Protocol):
    """A member with [jumps that fired | ports | constraints]; components: those of the member with energy in play."""

    fired: FiredEvents | None

    @property
    def components(self) -> Sequence[int]: ...
    def columns(self) -> ImpulseColumns:
        """Columns of the member in its present state."""
        ...

    def move(self, at: ImpulseColumns, m: Array) -> None: ...
    def place(self, t: float) -> None:
        """Gives the member its states."""
        ...


class EngineParty:
    """A member of an engine, with the events that have fired there."""

    def __init__(self, member: EngineMember, kernel: JumpKernel, fired: FiredEvents | None):
        self.components, self.fired = kernel.components, fired
        self._member, self._kernel, self._which = member, kernel, fired.jumps if fired else []
        self._x, self._p = member.instance.x.copy(), fired.p if fired else member.instance.parameters

    def columns(self) -> ImpulseColumns:
        return self._kernel.columns(self._x, self._p).chosen(self._which)

    def move(self, at: ImpulseColumns, m: Array) -> None:
        self._x[list(self._kernel.moved)] += at.L @ m

    def place(self, t: float) -> None:
        self._member.instance.set_x(t, self._x)
        if self.fired is None:  # else parameters are set, and then it is
            self._member.instance.initialise()


class UnitParty:
    """A unit that takes impulses; `ports`: places of those that are told, among those it takes (kicked: their outputs)."""

    components: Sequence[int] = (0,)
    fired: FiredEvents | None = None

    def __init__(self, member: FMUMember, offer: Offer, ports: list[int]):
        self._member, self._offer, self._ports = member, offer, ports

    def columns(self) -> ImpulseColumns:
        y = self._member.end_output()[self._offer.kicked][self._ports]
        S = self._offer.jump()[np.ix_(self._ports, self._ports)]
        return ImpulseColumns(np.zeros((0, len(y))), y[None], S, np.zeros(0))

    def move(self, at: ImpulseColumns, m: Array) -> None:
        s = np.zeros(len(self._offer.kicked))
        s[self._ports] = m
        self._member.shift(s, 0.0)

    def place(self, t: float) -> None:
        """Nothing: a unit moves its states itself."""


@dataclass(frozen=True)
class PartyPlace:
    """The place of a party: its ports by the impulses a between members (ports x a), and its first component among all."""

    at: Array
    component: int


class ImpulseSystem:
    """The columns of all, in the order jumps of all, a, constraints of all; energies of all `components` (rows of c)."""

    def __init__(self, parties: Sequence[Party], places: Sequence[PartyPlace]):
        self._parties, self._maps = parties, list[Array]()
        first = [p.columns() for p in parties]
        jumps = [len(c.e) for c in first]
        own = [len(c.S) - n - len(p.at) for c, n, p in zip(first, jumps, places, strict=True)]
        between = places[0].at.shape[1]
        jump, held = np.cumsum([0, *jumps]), sum(jumps) + between + np.cumsum([0, *own])
        self._n = int(held[-1])
        for i, p in enumerate(places):
            T = np.zeros((jumps[i] + len(p.at) + own[i], self._n))
            T[: jumps[i], jump[i] : jump[i + 1]] = np.eye(jumps[i])
            T[jumps[i] : jumps[i] + len(p.at), jump[-1] : jump[-1] + between] = p.at
            T[jumps[i] + len(p.at) :, held[i] : held[i + 1]] = np.eye(own[i])
            self._maps.append(T)
        self.components = np.array(
            [q.component + c for p, q in zip(parties, places, strict=True) for c in p.components], int
        )
        self._fired = [(p.fired, q.component) for p, q in zip(parties, places, strict=True) if p.fired is not None]
        jumping = [f.plan.owner[e] + at for f, at in self._fired for e in f.jumping]
        started, at = self._fired[0]
        #: components that lose what is left in each column: what is in no jump's, with the first event
        self.owners = np.array(
            [*jumping, *[started.plan.owner[started.events[0]] + at] * (self._n - len(jumping))], int
        )

    def columns(self) -> ImpulseColumns:
        found = [p.columns() for p in self._parties]
        S = sum((T.T @ c.S @ T for c, T in zip(found, self._maps, strict=True)), np.zeros((self._n, self._n)))
        c = np.vstack([c.c @ T for c, T in zip(found, self._maps, strict=True)])
        return ImpulseColumns(np.zeros((0, self._n)), c, S, np.concatenate([c.e for c in found]))

    def move(self, _: ImpulseColumns, m: Array) -> None:
        for p, T in zip(self._parties, self._maps, strict=True):
            p.move(p.columns(), T @ m)

    def strike(self, name: str, t: float) -> Array:
        """The work by component and column, of the impulses that move the parties; EventRefused under the name `name`."""
        rests = [e in f.rests for f, _ in self._fired for e in f.jumping]
        jump = [(f.plan.jump, f.jumps) for f, _ in self._fired if f.plan.jump is not None]
        most = np.concatenate([j.most[which] for j, which in jump])
        pushes = np.concatenate([j.pushes[which] > 0 for j, which in jump])
        names = [f.plan.names[e] for f, _ in self._fired for e in f.jumping]
        everything = [f.plan.names[e] for f, _ in self._fired for e in f.events]

        def refuse(reason: int, places: Sequence[int] | None, value: float, limit: float) -> NoReturn:
            raise EventRefused(
                name, t, reason, everything if places is None else [names[j] for j in places], value, limit
            )

        return struck(self.columns, self.move, Laws(np.array(rests, bool), most, pushes), refuse)
