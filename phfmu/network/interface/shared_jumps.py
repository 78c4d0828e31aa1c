"""Jumps that junctions share between members, and what these do together: see `joint_impulse.py` for the system.

A jump is shared where S couples it with an impulse between members (`impulse_directions.py`): at a rigid link, or at a node where
only states meet.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.engine.port_jumps import JumpKernel, jump_kernel
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.impulse_directions import directions
from phfmu.network.interface.joint_impulse import EngineParty, FiredEvents, ImpulseSystem, Party, PartyPlace, UnitParty
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.member import Member
from phfmu.network.members.node_values import InstanceNodes, Offer, node_values
from phfmu.terms.port_impulses import Impulse

if TYPE_CHECKING:
    from phfmu.network.members.fmu_member import FMUMember

Array = NDArray[Any]


class SharedJumps:
    """Shared jumps of the members of `joined`; nothing is made for networks without jumps."""

    def __init__(self, joined: CoupledMembers):
        self._joined = joined
        counts = [len(m.booking.components) for m in joined.members]
        self._components = np.cumsum([0, *counts]).tolist()

    @cached_property
    def of(self) -> dict[str, frozenset[int]]:
        """Member -> its events whose jumps act on other members too."""
        found = dict[str, frozenset[int]]()
        for i, m in enumerate(self._joined.members):
            if not isinstance(m, EngineMember) or not _jumps(m) or (kernel := self._kernels[i]) is None:
                continue
            reached = set(np.flatnonzero(self._at[i].any(axis=1)).tolist())
            of = m.model.events.jump.of  # pyright: ignore[reportOptionalMemberAccess]
            own = frozenset(e for e in np.flatnonzero(of >= 0).tolist() if kernel.couples[of[e]] & reached)
            if own:
                found[m.name] = own
        return found

    def jump(self, t: float, fired: Mapping[int, FiredEvents]) -> tuple[Array, Array]:
        """Moves the states of all members that the jumps of members number i reach.

        Energies that the components of the network got, and what they lost.  Raises EventRefused.
        """
        numbers, own = self.reached(list(fired))
        parties = [self._party(i, fired.get(i)) for i in numbers]
        joint = ImpulseSystem(parties, [PartyPlace(self._at[i][:, own], self._components[i]) for i in numbers])
        work = joint.strike(self._joined.network.name, t)
        energy, lost = np.zeros((2, self._components[-1]))
        energy[joint.components] = work.sum(axis=1)
        np.add.at(lost, joint.owners, -work.sum(axis=0))
        for party in parties:
            party.place(t)
        return energy, lost

    def reached(self, members: list[int]) -> tuple[list[int], list[int]]:
        """Numbers of the members that impulses of `members` reach, these too, and of the impulses between them."""
        touched = np.array([at.any(axis=0) for at in self._at], bool)  # members x a
        inside = np.isin(np.arange(len(touched)), members)
        while True:
            own = touched[inside].any(axis=0)
            more = inside | touched[:, own].any(axis=1)
            if (more == inside).all():
                return np.flatnonzero(inside).tolist(), np.flatnonzero(own).tolist()
            inside = more

    # -- members ----------------------------------------------------------------------------------------------------------

    @cached_property
    def _kernels(self) -> list[JumpKernel | None]:
        return [_kernel(m) for m in self._joined.members]

    @cached_property
    def _offers(self) -> list[Offer | None]:
        """Offers of units."""
        return [None if isinstance(m, EngineMember) else _offer(m) for m in self._joined.members]

    def _inputs(self, i: int) -> list[int]:
        """Places of its inputs with impulses."""
        if (kernel := self._kernels[i]) is not None:
            return list(kernel.inputs)
        offer = self._offers[i]
        return [] if offer is None else [offer.kicked[j] for j in _pairs(offer)]

    @cached_property
    def _at(self) -> list[Array]:
        """Ports with impulses of each member by the impulses between members (ports x a)."""
        inputs = [np.array(self._inputs(i), int) for i in range(len(self._joined.members))]
        face, places = self._joined.face, self._joined.places
        at = [p.start + own for p, own in zip(places, inputs, strict=True)]
        _, B = directions(face, at)
        through = (face.P @ B).toarray()
        return [through[own] for own in at]

    def _party(self, i: int, fired: FiredEvents | None) -> Party:
        member, kernel = self._joined.members[i], self._kernels[i]
        if isinstance(member, EngineMember):
            assert kernel is not None
            return EngineParty(member, kernel, fired)
        offer = self._offers[i]
        assert offer is not None
        return UnitParty(cast("FMUMember", member), offer, _pairs(offer))


def _jumps(m: EngineMember) -> bool:
    events = m.model.events
    return m.model.modes is None and events is not None and events.jump is not None and events.jump.n > 0


def _kernel(m: Member) -> JumpKernel | None:
    """None for what takes no impulses: its jumps are its own."""
    if not isinstance(m, EngineMember) or m.model.modes is not None or not m.model.scheme.impulses:
        return None
    try:
        return jump_kernel(m.model.declaration)
    except DeclarationError:  # what does not fit in one system
        return None


def _offer(m: Member) -> Offer | None:
    values = node_values(m)
    return values.offer if isinstance(values, InstanceNodes) else None


def _pairs(offer: Offer) -> list[int]:
    """Places among its impulses of those along which H is quadratic."""
    fit = {j for p in offer.ports.values() if p.kind is Impulse.PAIR for j in p.inputs}
    return [n for n, j in enumerate(offer.kicked) if j in fit]
