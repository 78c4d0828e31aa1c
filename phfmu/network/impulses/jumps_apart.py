"""Jumps of a member of what a junction ties to others: stepped apart, no impulse reaches those within the step of one."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from phfmu.engine.event_jump import JumpColumns
from phfmu.engine.reference.python import PythonInstance
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.junction_values import JunctionValues
from phfmu.network.members.engine_member import EngineMember
from phfmu.outcome.status import ACROSS, EventRefused

#: of the energy of a member: what a jump may bring in or lose there as rounding (a pole that opens at its current zero)
ROUNDING = 1e-12


class JumpsApart:
    """The part of the members' jumps that others share: velocities of rigid links, currents of nodes where inductors meet."""

    def __init__(self, joined: CoupledMembers, sums: JunctionValues):
        self._joined, self._sums = joined, sums
        self._jumping = [
            m for m in joined.members if isinstance(m, EngineMember) and m.model.events is not None and _jumps(m.model)
        ]

    def require_own(self) -> None:
        """EventRefused where a jump in the last step moved what its member shares with others."""
        for m in self._jumping:
            for h in () if m.together else m.instance.happened:
                shared = [i for i in h.events if i in self._shared.get(m.name, ())]
                size = np.abs(h.energy).sum()
                if shared and size > ROUNDING * (np.abs(m.energies()).sum() + size):
                    names = [m.model.events.names[i] for i in shared]  # pyright: ignore[reportOptionalMemberAccess]
                    raise EventRefused(m.name, h.t, ACROSS, names, float(size), 0.0)

    def across(self) -> list[str]:
        """Events inside the steps of members whose jumps would move what others share, `member.event`."""
        return [
            f"{m.name}.{m.model.events.names[i]}"  # pyright: ignore[reportOptionalMemberAccess]
            for m in self._jumping
            for i in sorted(self._shared.get(m.name, ()))
            if not m.together
        ]

    @cached_property
    def _shared(self) -> dict[str, set[int]]:
        """By member the events whose jumps move an output that junction rows hold whatever their unknowns are."""
        held, first, found = self._sums.held_outputs, 0, dict[str, set[int]]()
        for m in self._joined.members:
            if isinstance(m, EngineMember) and m in self._jumping:
                found[m.name] = _moving(m.model, held[first : first + m.nu])
            first += m.nu
        return found


def _jumps(model: Any) -> bool:
    return model.modes is None and model.events.jump is not None and model.events.jump.n > 0


def _moving(model: Any, held: Any) -> set[int]:
    """Events whose jump, at the start of the model, changes one of the `held` outputs."""
    instance, jump = PythonInstance(model), model.events.jump
    t, x = instance.time, instance.x.copy()
    y = instance.signal("y_end")[: len(held)].copy()
    L = JumpColumns(model.events).at(np.append(x, t), instance.parameters).L
    found = set[int]()
    for i in np.flatnonzero(jump.of >= 0):
        moved = x.copy()
        moved[jump.moved] += L[:, jump.of[i]] / np.abs(L[:, jump.of[i]]).max()
        instance.set_x(t, moved)
        if (instance.signal("y_end")[: len(held)] != y)[held].any():
            found.add(int(i))
    return found
