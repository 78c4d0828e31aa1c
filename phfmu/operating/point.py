"""The operating point of a network: power flow and all start values in one sparse Newton iteration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import atan2, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.network import Network
from phfmu.operating.reactive_limits import Switching
from phfmu.operating.rotation import BALANCED, TURN, MemberEquations, three_phase
from phfmu.operating.set_points import require_within_limits, solved_in_blocks
from phfmu.operating.specifications import Specification
from phfmu.operating.system import NoOperatingPoint, System
from phfmu.signals import of_member

Array = NDArray[np.float64]

#: voltages, as shares of those that the iteration begins with, that no grid is run at
SOUND = (0.7, 1.3)


@dataclass(frozen=True)
class NetworkPoint:
    """An operating point: start values by `member.name`, voltages by junction, and how well the equations hold.

    states, algebraics, inputs, parameters: values by scalar name;  voltages [V]: phase values at t = 0 of three-phase
    junctions;  currents [A]: into members, by port, where they were unknowns;  residuals: of the rate of each state, relative to
    w times its nominal value;  iterations: of Newton's method;  limited: delivered reactive power [var] by port, of regulators
    that cannot hold their voltage within their limits.
    """

    network: Network
    omega: float
    states: dict[str, float]
    algebraics: dict[str, float]
    inputs: dict[str, float]
    parameters: dict[str, float]
    voltages: dict[str, Array]
    currents: dict[str, Array]
    residuals: dict[str, float]
    iterations: int
    _equations: dict[str, MemberEquations] = field(repr=False)
    limited: dict[str, float] = field(default_factory=dict)

    @property
    def residual(self) -> float:
        """The largest of the residuals."""
        return max(self.residuals.values(), default=0.0)

    def magnitude(self, junction: str) -> float:
        """Voltage of a three-phase junction in V rms, line to line."""
        return float(np.linalg.norm(self.voltages[junction]))

    def angle(self, junction: str) -> float:
        """Angle of phase a of its voltage in rad."""
        real, imaginary = BALANCED.T @ self.voltages[junction]
        return atan2(imaginary, real)

    def power(self, port: str) -> complex:
        """P + jQ in VA that the member takes at a port whose current was an unknown."""
        v, i = self.voltages[self.junction_of(port)], self.currents[port]
        return complex(v @ i, v @ TURN @ i)

    def junction_of(self, port: str) -> str:
        """The junction that a port `member.name` is at."""
        return self._junctions[port]

    @cached_property
    def _junctions(self) -> dict[str, str]:
        return {str(end): j.name for j in self.network.junctions for end in j.ends}

    def started(self) -> Network:
        """The network with the point as its start."""
        members: dict[str, Any] = dict(self.network.members)
        own: dict[str, dict[str, float]] = {name: {} for name in self.network.declared}
        for n, v in (self.states | self.algebraics | self.inputs | self.parameters).items():
            member, _, rest = n.partition(".")
            if member in own:
                own[member][rest] = v
        for name, model in self.network.declared.items():
            members[name] = model.with_starts(own[name])
        return replace(self.network, members=members)

    def turned_back(self, states: Mapping[str, float], t: float) -> dict[str, float]:
        """The states of a later time t, turned back to the start: equal to `states` where the motion is steady."""
        out = {}
        for name, model in self.network.declared.items():
            names = [of_member(name, n) for v in model.states for n in v.names()]
            turned = self._equations[name].turned([states[n] for n in names], -self.omega * t)
            out |= dict(zip(names, turned.tolist(), strict=True))
        return out

    def drift(self, states: Mapping[str, float], t: float) -> dict[str, float]:
        """Distance of each state of a later time t [s], turned back, from the start, relative to the amplitude of its variable.

        The amplitude is that of the start, or a thousandth of the nominal value where that is more.
        """
        back, found = self.turned_back(states, t), dict[str, float]()
        for name, model in self.network.declared.items():
            for v in model.states:
                names = [of_member(name, n) for n in v.names()]
                size = max(*(abs(self.states[n]) for n in names), 1e-3 * float(np.max(np.abs(v.nominal))))
                found |= {n: abs(back[n] - self.states[n]) / size for n in names}
        return found


def operating_point(net: Network, specifications: Sequence[Specification], frequency: float = 60.0) -> NetworkPoint:
    """The balanced steady state of a network at `frequency` [Hz] that meets the specifications.

    `net` has declared members with three-phase electrical ports, and whatever stands beside them (shafts, sources, signals to
    controllers).  Controllers whose set points are freed for a field voltage or a torque are solved after the network.
    Where nothing fixes the angle of the voltages, one specification is a `Slack`.
    NoOperatingPoint names members that are not symmetric under rotation of the phases, sources of another frequency, numbers of
    equations and unknowns that differ, voltages that no grid is run at, and limits of controllers that the point lies
    beyond.  KeyError names ports and free names that are not there.
    A `PV` whose Q would be beyond its limits delivers the limit instead (`limited`), as long as its voltage stays on that side.
    """
    switching = Switching(net.name, specifications)
    taken, limits = 0, True
    while limits:
        system = System(net, switching.now, 2.0 * pi * frequency)
        v, iterations = solved_in_blocks(system)
        taken += iterations
        point = _told(system, v, taken)
        _require_sound(system, point)
        limits = switching.moved(point)
    require_within_limits(net, point.states | point.parameters)
    return replace(point, limited=switching.limited)


def _told(system: System, v: Array, iterations: int) -> NetworkPoint:
    """The point in values by name."""
    F, _ = system.evaluate(v)
    z = system.P @ v + system.constant
    states, algebraics, inputs, parameters, residuals = {}, {}, {}, {}, {}
    for name, e in system.kind_of.items():
        model, n, at = system.declared[name], e.size, system.place[name]
        x, a, u, p, _ = np.split(z[at : at + n.z], np.cumsum([n.x, n.a, n.u, n.p]))
        states |= _by_name(name, model.states, x)
        algebraics |= _by_name(name, model.algebraics, a)
        parameters |= _by_name(name, model.parameters, p)
        for port, k in e.ports:
            if port.source is None:
                inputs |= {of_member(name, m): float(u[k + i]) for i, m in enumerate(port.input_names())}
        nominal = np.abs(np.concatenate([np.zeros(0), *(np.atleast_1d(s.nominal) for s in model.states)]))
        share = np.abs(F[system.row_of[name] :][: n.x]) / (
            system.omega * np.maximum(np.where(nominal == 0, 1.0, nominal), np.abs(x))
        )
        residuals |= _by_name(name, model.states, share)
    voltages, currents = {}, {}
    for j in system.net.junctions:
        port = next(iter(j.ports(system.declared).values()))
        if three_phase(port) and j.shared == "effort":
            at = system.common[j.name][0]
            voltages[j.name] = BALANCED @ v[at : at + 2]
    for end, (at, phases) in system.current.items():
        if phases and system.at_port[end][0].shared == "effort":
            currents[str(end)] = BALANCED @ v[at : at + 2]
    return NetworkPoint(
        system.net,
        system.omega,
        states,
        algebraics,
        inputs,
        parameters,
        voltages,
        currents,
        residuals,
        iterations,
        system.kind_of,
    )


def _require_sound(system: System, point: NetworkPoint) -> None:
    """A solution with voltages far from those of the start is another one than that asked for."""
    for name, voltage in point.voltages.items():
        at = system.common[name][0]
        begun = float(np.linalg.norm(system.start[at : at + 2]))
        share = float(np.linalg.norm(voltage)) / begun if begun else 1.0
        if not SOUND[0] <= share <= SOUND[1]:
            raise NoOperatingPoint(
                f"{system.net.name}: the voltage of {name} would be {share:.3g} of {begun:.4g} V, which it begins with: another "
                "solution of the equations than a grid is run at; begin nearer to the one that is meant, or check the powers"
            )


def _by_name(member: str, variables: Sequence[Any], values: Array) -> dict[str, float]:
    names = [of_member(member, n) for v in variables for n in v.names()]
    return dict(zip(names, values.tolist(), strict=True))
