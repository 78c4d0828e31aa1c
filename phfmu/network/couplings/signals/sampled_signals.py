"""Signals between members that are stepped apart: sampled where steps meet, held over a step.

Those that are exchanged at the nodes of steps are sampled only.  The held value of the others is that of the line
through the last two samples in the middle of the step,

    s_n + h_n (s_n - s_{n-1}) / (2 h_{n-1}),

cut at the limits of the input: order 2, without iteration.  After events, and in the first step, it is s_n.  On request it is
s_n always, which is of order 1, or the mean of both ends, which is iterated (`agreed_signals.py`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.entries.parameter_limits import declared_limits
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.members.member import Member
from phfmu.network.network import Network
from phfmu.network.wires import Wire
from phfmu.signals import of_member

Array = NDArray[np.float64]

#: what a held signal is over a step: the line through the last two samples, the last one, or a mean that is iterated, in the
#: steps in which one is found or in all
SignalExchange = Literal["extrapolated", "held", "agreed-or-extrapolated", "agreed"]
#: the order that follows
ORDER = 2
ORDERS: dict[SignalExchange, int] = {"extrapolated": ORDER, "held": 1, "agreed-or-extrapolated": ORDER, "agreed": ORDER}
#: where state events follow signals or signals follow what events set: one is seen at the next step
ORDER_OF_EVENTS = 1


@dataclass(frozen=True)
class _WireGroup:
    """Wires that can be sampled together: (member, names, places in the samples) read, then written."""

    read: list[tuple[Member, list[str], list[int]]] = field(default_factory=list)
    write: list[tuple[Member, list[str], list[int]]] = field(default_factory=list)


class SampledSignals:
    """The signals of a network; without wires nothing is done.  The samples themselves are `CoupledMembers.sampled`."""

    CARRIED = ("before", "last")

    def __init__(self, joined: CoupledMembers, at_nodes: Collection[int] = (), extrapolated: bool = True):
        """`at_nodes`: numbers of the wires that are exchanged there;  `extrapolated`: False holds the last sample."""
        self.extrapolated = extrapolated
        network = joined.network
        self.wires, self._joined = network.wires, joined
        self._members = {m.name: m for m in joined.members}
        self._input_places = dict(zip(self._members, joined.places, strict=True))
        self._at_nodes = np.array([i in at_nodes for i in range(len(self.wires))], bool)
        #: of a wire into a port: its place among all inputs
        self._port = np.array([joined.taken.get((w.target, w.input), -1) for w in self.wires], int)
        #: numbers of the wires that are sampled together
        self.stages = _stages(network.wires)
        self._groups = [self._group(numbers) for numbers in self.stages]
        self._numbers = np.flatnonzero(~self._at_nodes)
        #: wires that are held over a step
        self.held = [self.wires[i] for i in self._numbers]
        self._held_group = self._group(self._numbers.tolist())
        self._held = self._held_group.write
        self.any_held = not self._at_nodes.all()
        self.limits = self._low, self._high = _limits(network)
        self._factor, self._offset = (np.array([getattr(w, n) for w in self.wires]) for n in ("factor", "offset"))
        self._now = joined.sampled
        joined.free[self._port[self._at_nodes]] = self._offset[self._at_nodes]
        #: the samples before the last ones, where they are known, and the length of the step between
        self.before: Array | None = None
        self.last = 0.0
        #: samples of compiled steps, a row each
        self.rows: list[Array] = []

    def feeds(self, name: str) -> bool:
        """Whether `member.input`, or an entry of it, is fed by a wire."""
        fed = [of_member(w.target, w.input) for w in self.wires]
        return any(name in (n, n.partition("[")[0]) for n in fed)

    def sample(self, xi: Array) -> None:
        """Outputs at the present time, and with them all inputs, which are now what the network says; xi: of junctions."""
        for group in self._groups:
            for member, names, places in group.read:
                self._now[places] = self._factor[places] * member.read_signals(names) + self._offset[places]
            self._write(group.write, self._now, xi)

    def forget(self) -> None:
        """Forgets the samples: the next step is not the continuation of the last one."""
        self.before = None

    def hold(self, h: float, xi: Array) -> None:
        """Inputs for the next step, of length h, from the samples at its start."""
        if self.before is None or not self.any_held or not self.extrapolated:
            return
        self._write(self._held, self._cut(self._now + (h / (2.0 * self.last)) * (self._now - self.before)), xi)

    def _cut(self, values: Array) -> Array:
        """Within the limits of the inputs, where the samples are."""
        inside = (self._low <= self._now) & (self._now <= self._high)
        return np.where(inside, np.clip(values, self._low, self._high), self._now)

    # -- iterated to agreement: w, the held signals at the end of a step ------------------------------------------------

    @property
    def now(self) -> Array:
        """The held signals as they are now."""
        return self._now[self._numbers]

    def set_now(self, w: Array, xi: Array) -> None:
        """Samples and inputs."""
        self._now[self._numbers] = w
        self._write(self._held, self._now, xi)

    def ahead(self, h: float) -> Array:
        """The line through the last two samples at the end of the next step."""
        if self.before is None:
            return self.now
        return (self._now + (h / self.last) * (self._now - self.before))[self._numbers]

    def hold_towards(self, w: Array, xi: Array) -> None:
        """Inputs for the next step: the mean of its ends."""
        self._write(self._held, self._cut((self._now + self._whole(w)) / 2.0), xi)

    def sent_under(self, w: Array, xi: Array) -> Array:
        """Values of the held wires at the present time where they have brought w."""
        found = self._whole(w)
        self._write(self._held, found, xi)
        for member, names, places in self._held_group.read:
            found[places] = self._factor[places] * member.read_signals(names) + self._offset[places]
        return found[self._numbers]

    def _whole(self, w: Array) -> Array:
        """All signals, with w for those that are held."""
        found = self._now.copy()
        found[self._numbers] = w
        return found

    def stepped(self, h: float, xi: Array, w: Array | None = None) -> None:
        """After a step of length h: samples at its end, where the junction unknowns are xi; w: what held signals agreed on."""
        if self.wires:
            self.before, self.last = self._now.copy(), h
            if w is not None:
                self._write(self._held, self._whole(w), xi)
            self.sample(xi)

    @property
    def all_held(self) -> bool:
        """Whether every wire is held over steps."""
        return bool(self.wires) and not self._at_nodes.any()

    @property
    def into_ports(self) -> bool:
        """Whether one ends at a port."""
        return bool((self._port >= 0).any())

    def took(self, rows: Array, before: Array | None, last: float) -> None:
        """Compiled code has taken steps, with these samples at their ends."""
        self.rows += list(rows)
        self.last = last
        self.before = None if before is None else before.copy()

    def state(self) -> tuple[Array, Array | None, float]:
        return self._now.copy(), self.before, self.last

    def restore(self, state: tuple[Array, Array | None, float]) -> None:
        """Samples of an earlier time; the members are brought back by others."""
        self._now[:], self.before, self.last = state
        self.rows = []
        self._place(np.flatnonzero(self._port >= 0), self._now)

    def follow(self, other: SampledSignals) -> None:
        """Goes on from the signals of the same network under another exchange, whose inputs that are free are set already."""
        self._joined.free[self._port[self._at_nodes]] = self._offset[self._at_nodes]
        self.restore(other.state())

    def _group(self, numbers: Sequence[int]) -> _WireGroup:
        group = _WireGroup()
        for side, list_ in (("source", group.read), ("target", group.write)):
            # into a member, wires into ports are apart from those into parameters
            keys = [(getattr(self.wires[i], side), side == "target" and self._port[i] >= 0) for i in numbers]
            for name, port in dict.fromkeys(keys):
                own = [i for i, key in zip(numbers, keys, strict=True) if key == (name, port)]
                what = [self.wires[i].output if side == "source" else self.wires[i].input for i in own]
                list_.append((self._members[name], what, own))
        return group

    def _write(self, parts: list[tuple[Member, list[str], list[int]]], values: Array, xi: Array) -> None:
        for member, names, places in parts:
            if self._port[places[0]] < 0:
                member.write_signals(names, values[places])
                continue
            self._place(np.array(places), values)
            member.set_input(self._joined.inputs(xi)[self._input_places[member.name]])

    def _place(self, wires: NDArray[np.intp], values: Array) -> None:
        """Values of wires into ports, where the inputs of members are."""
        at_nodes = self._at_nodes[wires]
        there, held = wires[at_nodes], wires[~at_nodes]
        self._joined.held[self._port[there]] = values[there] - self._offset[there]
        self._joined.free[self._port[held]] = values[held]


def _stages(wires: Sequence[Wire]) -> list[list[int]]:
    """Numbers of the wires, which are in order, in runs in which no wire begins at a member that an earlier one ends at."""
    stages: list[list[int]] = []
    reached: set[str] = set()
    for i, w in enumerate(wires):
        if not stages or w.source in reached:
            stages.append([])
            reached = set()
        stages[-1].append(i)
        reached.add(w.target)
    return stages


def _limits(network: Network) -> tuple[Array, Array]:
    """Declared limits of the inputs that are fed."""
    known = {n: declared_limits(d) for n, d in network.declared.items()}
    found = [known.get(w.target, {}).get(w.input) for w in network.wires]
    low = [-np.inf if f is None else f.min for f in found]
    return np.array(low), np.array([np.inf if f is None else f.max for f in found])
