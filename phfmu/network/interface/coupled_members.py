"""Members of a network with the equations of their junctions: what all couplings of members work with.

With xi the junction unknowns (common variables and dual inputs), U = P xi + U_free the port inputs and Y the outputs
conjugate to them, the equations of all junctions are those of the composed model,

    r = P^T Y + C xi = 0,     C skew.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booking import Booking
from phfmu.network.compose import require_members
from phfmu.network.interface.interface import interface
from phfmu.network.interface.matrices import assembled, small
from phfmu.network.interface.prescribed_inputs import PrescribedInputs
from phfmu.network.junction import junction_unknowns
from phfmu.network.members.member import Member
from phfmu.network.members.predicted_member import PredictedMember
from phfmu.network.network import Network
from phfmu.outcome.limits import defined
from phfmu.signals import of_member
from phfmu.words import meant

Array = NDArray[np.float64]

_NUMBERS = defined(Path(__file__).parent.parent / "couplings" / "runtime" / "in_turn.h")
#: relative change of an input that tells whether outputs follow it;  part of an output below which a change of it is none
MOVE, ROUNDING = _NUMBERS["INSTANT_MOVE"], _NUMBERS["INSTANT_ROUNDING"]


class CoupledMembers:
    """Stacked: inputs and outputs of all members (nu); `face`: P (nu x n) and C (n x n).  ConnectionError without members."""

    CARRIED = ("members", "free", "held", "sampled", "booking")

    def __init__(self, network: Network, members: list[Member]):
        require_members(network.name, network.members)
        self.network, self.members = network, members
        self.face = interface(network, members)
        #: members whose steps are put off until `finish`
        self.put_off = [m for m in members if isinstance(m, PredictedMember)]
        #: relative difference of steps that members take again, which units may have; 0 where all take them to rounding
        self.repeated = max((m.repeated for m in members), default=0.0)
        self.booking = _booking(network, members)
        self.names = [of_member(m.name, n) for m in members for n in m.names]
        ends = np.cumsum([0, *(m.nu for m in members)]).tolist()
        #: where the inputs of each member are among all
        self.places = [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        #: U_free
        self.free = np.concatenate([m.start_inputs() for m in members])
        self.free[self.face.fed] = 0.0
        #: those of U_free that follow data
        self.followed: PrescribedInputs | None = None
        #: signals that are exchanged at the nodes of steps: as they are now, less the offsets of their wires, which are in free
        self.held = np.zeros(len(self.free))
        #: of each wire the signal as it is now
        self.sampled = np.zeros(len(network.wires))
        self.taken, self.sent = self._signal_places()
        self._reach = [self.face.reach(p) for p in self.places]
        #: C and |C| of the interface, arrays where they are small
        self.C = small(self.face.C)
        self._abs_C = abs(self.C)

    def components(self, member: str) -> slice:
        """Places of the components of a member among those of all."""
        first = 0
        for m in self.members:
            end = first + len(m.booking.components)
            if m.name == member:
                return slice(first, end)
            first = end
        raise KeyError(member)

    @property
    def ended(self) -> str:
        """Members that have asked to end the simulation in the last step."""
        return ", ".join(m.name for m in self.members if m.ended)

    # -- a step -----------------------------------------------------------------------------------------------------

    def inputs(self, xi: Array) -> Array:
        """U = P xi + U_free (nu), with signals as they are now."""
        return self.face.inputs(xi) + self.free + self.held

    def _signal_places(self) -> tuple[dict[tuple[str, str], int], dict[tuple[str, str], int]]:
        """(member, signal) of those that ports take and send -> place among all inputs and outputs."""
        taken, sent = dict[tuple[str, str], int](), dict[tuple[str, str], int]()
        for m, place in zip(self.members, self.places, strict=True):
            taken |= {(m.name, n): place.start + i for n, i in m.taken.items()}
            sent |= {(m.name, n): place.start + i for n, i in m.sent.items()}
        return taken, sent

    @property
    def _wired(self) -> list[tuple[str, str]]:
        return [(w.target, w.input) for w in self.network.wires]

    def reach(self, i: int) -> tuple[NDArray[np.intp], Array]:
        """The unknowns that feed member number i, and the block of P with these columns."""
        return self._reach[i]

    def apply(self, xi: Array) -> None:
        """Give every member its inputs."""
        u = self.inputs(xi)
        for m, place in zip(self.members, self.places, strict=True):
            m.set_input(u[place])

    def begin(self, xi: Array) -> None:
        """Give every member its inputs before its first step: what it tells is then that of the instant under them."""
        u = self.inputs(xi)
        for m, place in zip(self.members, self.places, strict=True):
            m.begin(u[place])

    def finish(self) -> None:
        """Members that were put off take the step that the others took, and some take theirs for good."""
        for m in self.members:
            if m.finishes:
                m.finish()

    def rows(self, xi: Array, y: Array) -> Array:
        """r = P^T Y + C xi (n)."""
        return self.face.summed(y) + self.C @ xi

    def matrix(self, sensitivities: list[Array]) -> Any:
        """dr/dxi = P^T G P + C (n x n, sparse where it is large) of G = dY/dU, a block (its nu x its nu) per member."""
        parts = zip(self._reach, sensitivities, strict=True)
        return assembled(self.C, ((own, own, P.T @ g @ P) for (own, P), g in parts))

    def row_sizes(self, xi: Array, y: Array) -> Array:
        """The terms that each row is a sum of (n); a row without terms is measured by nominal values."""
        face = self.face
        return face.summed(np.abs(y)) + self._abs_C @ np.abs(xi) + 1e-12 * face.row_nominal

    def instant_matrix(self, xi: Array) -> Any:
        """dr/dxi at the present time, where the inputs are those of xi (n x n, sparse where it is large)."""
        u, parts = self.inputs(xi), []
        for m, place, (own, _) in zip(self.members, self.places, self._reach, strict=True):
            parts.append(_instant_sensitivity(m, u[place]) if len(own) else np.zeros((m.nu, m.nu)))
        return self.matrix(parts)

    def states(self, needed: bool = True) -> list[Any]:
        """States of all members; where they are not `needed`, None for those that cannot save theirs."""
        return [m.get_state() if needed or m.saves else None for m in self.members]

    def restore(self, states: list[Any]) -> None:
        for m, s in zip(self.members, states, strict=True):
            if s is not None:
                m.set_state(s)

    def unsteady(self, h: float) -> str:
        """Members that do not repeat a step of length h from where they are, in words."""
        return "; ".join(f"{m.name} {words}" for m in self.members if (words := m.unsteady(h)))

    # -- what can be set, what there is to tell -----------------------------------------------------------------------

    @property
    def units(self) -> dict[str, str]:
        """Units of the members' names and inputs, and of the junction unknowns."""
        own = {of_member(m.name, n): unit for m in self.members for n, unit in m.units.items()}
        for j in self.network.junctions:
            unknown = junction_unknowns(self.network.members, j)
            own |= {n: v.unit for v in (unknown.common, *unknown.dual.values()) for n in v.names()}
        return own

    def free_inputs(self) -> dict[str, float]:
        """Inputs of ports that no junction feeds and signals, `member.name`, as they are now."""
        joined = np.zeros(len(self.free), bool)
        joined[[*self.face.fed, *self.sent.values(), *(self.taken[e] for e in self._wired if e in self.taken)]] = True
        told: dict[str, float] = {}
        for m, place in zip(self.members, self.places, strict=True):
            values = self.free[place] / m.input_sign
            rows = zip(m.input_names, values.tolist(), joined[place], strict=True)
            told |= {of_member(m.name, n): value for n, value, fed in rows if not fed}
            told |= {of_member(m.name, n): value for n, value in m.signals().items()}
        return self._as_declared(told)

    def _as_declared(self, told: dict[str, float]) -> dict[str, float]:
        """In the order of the members as they were declared, if some of them are composed to one."""
        declared = self.network.gathered_from
        if declared is None:
            return told
        place = {n: i for i, n in enumerate(declared.members)}
        return dict(sorted(told.items(), key=lambda item: place[item[0].partition(".")[0]]))

    def input_places(self) -> dict[str, tuple[int, float]]:
        """Input of a port, `member.name` -> its place among all inputs, and its factor into the member."""
        return {
            of_member(m.name, n): (place.start + i, float(m.input_sign[i]))
            for m, place in zip(self.members, self.places, strict=True)
            for i, n in enumerate(m.input_names)
        }

    def settable(self) -> list[str]:
        return [of_member(m.name, n) for m in self.members for n in m.settable()]

    def set_value(self, name: str, value: float, xi: Array) -> str:
        """Set a member's parameter or free input `member.name` and say which it is; KeyError names close ones."""
        member, _, rest = name.partition(".")
        for m, place in zip(self.members, self.places, strict=True):
            if m.name in ("", member):
                known = rest if m.name else name
                own = m.input_places(known)
                indices = [place.start + i for i in own]
                if indices:
                    if (self.face.column[indices] >= 0).any():
                        raise KeyError(f"{name} is fed by a junction; it cannot be set")
                    self.free[indices] = value * m.input_sign[own]
                    m.set_input(self.inputs(xi)[place])
                    return "input"
                if kind := m.set_parameter(known, value):
                    held = constants([m.booking for m in self.members])
                    if held != self.booking.constants:
                        self.booking = replace(self.booking, constants=held)
                    return kind
        raise KeyError(f"{self.network.name} has no parameter or input '{name}'; {meant(name, self.settable())}")

    def read(self) -> Array:
        """Values of `names` now."""
        return np.concatenate([m.read() for m in self.members])

    def energies(self) -> Array:
        return np.concatenate([m.energies() for m in self.members])

    def end_outputs(self) -> Array:
        """Outputs at the present time (nu)."""
        return np.concatenate([m.end_output() for m in self.members])


def _instant_sensitivity(member: Member, u: Array) -> Array:
    """G = dy/dU (nu x nu) of a member at the present time, by differences; its inputs are u again afterwards."""
    member.set_input(u)  # what it tells may still be of others
    base = np.array(member.end_output())
    G = np.zeros((len(u), len(u)))
    for j in range(len(u)):
        moved = u.copy()
        moved[j] += MOVE * (abs(u[j]) + member.nominal[j])
        member.set_input(moved)
        change = np.array(member.end_output()) - base
        change[np.abs(change) <= ROUNDING * np.abs(base)] = 0.0
        G[:, j] = change / (moved[j] - u[j])
    member.set_input(u)
    return G


def _booking(network: Network, members: list[Member]) -> Booking:
    """The audit names of all members; ports that meet are booked at their junction."""
    at = {str(e): j.name for j in network.junctions for e in j.ends}
    components = tuple(c for m in members for c in m.booking.components)
    ports = tuple(
        replace(p, junction=at.get(f"{p.component}.{p.port}", p.junction)) for m in members for p in m.booking.ports
    )
    return Booking(
        components,
        ports,
        frozenset(c for m in members for c in m.booking.silent),
        constants=constants([m.booking for m in members]),
    )


def constants(bookings: list[Booking]) -> tuple[float, ...]:
    """By component, what is constant in H; () where nothing is."""
    if not any(b.constants for b in bookings):
        return ()
    return tuple(c for b in bookings for c in b.constants or (0.0,) * len(b.components))
