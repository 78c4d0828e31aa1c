"""What a unit exchanges in a step beside held inputs and means: values at its nodes, impulses at its ends, their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.engine.node_sensitivity import NodeSensitivity
from phfmu.engine.status import Status, StepFailure
from phfmu.fmu.interface import Scalar
from phfmu.fmu.manifest import PortMap
from phfmu.fmu.port_values import PortValues
from phfmu.fmu.slave import AnySlave
from phfmu.fmu.values import Derivative, References
from phfmu.fmu.variables import FMUError
from phfmu.fmu.version import VERSIONS
from phfmu.terms.port_impulses import Impulse, PortImpulse

Array = NDArray[np.float64]


def impulse_ports(ports: Sequence[PortMap]) -> tuple[PortImpulse, ...]:
    """What the ports of a manifest do with impulses; empty of a unit without."""
    places = {n: i for i, n in enumerate(n for p in ports for n in p.inputs)}
    return tuple(
        PortImpulse(p.name, Impulse(p.impulse), tuple(places[n] for n in p.inputs), p.linear, p.why)
        for p in ports
        if p.impulse in set(Impulse)
    )


class NodeExchange:
    """Of a unit exported with inputs at nodes; all arguments and results count into the component."""

    def __init__(self, slave: AnySlave, values: PortValues):
        self._slave, self._values, self._face = slave, values, values.interface
        self.name = values.name
        self._known: dict[tuple[bool, str], Derivative] = {}
        #: places of the inputs that take impulses, in the order of `jump`
        self.kicked = [values.inputs.index(n) for n in values.kicked]

    def set_node_inputs(self, u: ArrayLike) -> None:
        """k x nu; FMUError if the unit was exported without them."""
        self._values.take_at_nodes(u)
        if self._values.nu:
            self._slave.set(self._values.u_nodes)

    def node_output(self) -> Array:
        """k x nu."""
        shape = len(self._face.nodes), self._values.nu
        return self._slave.get(self._values.y_nodes).reshape(shape) * self._values.output_sign

    @cached_property
    def impulse_ports(self) -> tuple[PortImpulse, ...]:
        """What each port does with impulses; empty if the unit was exported without."""
        return impulse_ports(self._values.ports)

    def set_impulses(self, s0: ArrayLike, s1: ArrayLike) -> None:
        """At start and end of the coming steps (n each), until they are set again."""
        n = len(self.kicked)
        values = np.array([s0, s1], float)
        if not n or values.shape != (2, n) or not np.isfinite(values).all():
            names = f", for {', '.join(self._values.kicked)}" if n else "; export it with --impulses"
            raise ValueError(f"{self.name}: expected {n} finite impulses at start and end{names}")
        self._values.impulses.values[:] = (values / self._values.input_sign[self.kicked]).ravel()
        self._slave.set(self._values.impulses)

    def jump(self) -> Array:
        """S = L^T H'' L at the present time (n x n)."""
        n = len(self.kicked)
        s = np.zeros((n, n))
        if n:
            s[np.tril_indices(n)] = self._slave.get(self._values.jump)
        return s + np.tril(s, -1).T

    def node_sensitivity(
        self, inputs: Sequence[int] | None = None, impulses: bool = False, end: bool = False
    ) -> NodeSensitivity:
        """As of the engines; states of a unit are not known, and `end` needs one with impulses.

        StepFailure NO_SENSITIVITY if the unit refuses.
        """
        v, k = self._values, len(self._face.nodes)
        chosen = list(range(v.nu) if inputs is None else inputs)
        known = [v.u_nodes.scalars[i * v.nu + j] for i in range(k) for j in chosen]
        known += v.impulses.scalars if impulses else ()
        rows = v.y_nodes_end if end else v.y_nodes
        try:
            found = np.array([self._slave.derivative(self._derivative(end, rows, s)).copy() for s in known])
        except FMUError as error:
            raise StepFailure(Status.NO_SENSITIVITY, self.name, 0.0, 0.0, tried=str(error)) from error
        found = found.reshape(len(known), rows.n).T * np.tile(v.output_sign, k + end)[:, None]
        sign = [np.tile(v.input_sign[chosen], k), *[v.input_sign[self.kicked]] * (2 * impulses)]
        found = found / np.concatenate(sign)
        split = k * v.nu
        at_nodes = found[:split].reshape(k, v.nu, len(known))
        return NodeSensitivity(at_nodes, np.zeros((0, len(known))), found[split:] if end else None)

    def _derivative(self, end: bool, rows: References, known: Scalar) -> Derivative:
        key = (end, known.name)
        if key not in self._known:
            self._known[key] = Derivative(rows, known, VERSIONS[self._face.version])
        return self._known[key]
