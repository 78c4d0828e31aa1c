"""Exchange of a unit in a step beside held inputs and means: values at its nodes, impulses at its ends, their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.engine.node_sensitivity import NodeSensitivity
from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.ports.port_values import PortValues
from phfmu.fmu.importer.slave import AnySlave
from phfmu.fmu.importer.unit_interface import Scalar
from phfmu.fmu.importer.values import Derivative, References
from phfmu.fmu.version import VERSIONS
from phfmu.outcome.status import Status, StepFailure
from phfmu.terms.port_impulses import Impulse, PortImpulse

Array = NDArray[np.float64]


def impulse_ports(ports: Sequence[PortMap]) -> tuple[PortImpulse, ...]:
    """The use of impulses by the ports; empty for a unit without."""
    places = {n: i for i, n in enumerate(n for p in ports for n in p.inputs)}
    return tuple(
        PortImpulse(p.name, Impulse(p.impulse), tuple(places[n] for n in p.inputs), p.linear, p.why)
        for p in ports
        if p.impulse in set(Impulse)
    )


class NodeExchange:
    """The exchange of a unit exported with inputs at nodes; all arguments and results count into the component.

    Its `all` scalars at a node are nu of ports, then the signals that it takes, then those that it sends: their inputs are
    no one's, and the outputs of those that are taken are zero.
    """

    def __init__(self, slave: AnySlave, values: PortValues):
        self._slave, self._values, self._face = slave, values, values.interface
        self.name = values.name
        taken, sent = len(values.interface.taken), len(values.interface.sent)
        #: scalars at a node;  of these the inputs that exist, and the outputs
        self.all = values.nu + taken + sent
        self._sent = np.arange(values.nu + taken, self.all)
        self._known: dict[tuple[bool, str], Derivative] = {}
        #: places of the inputs that take impulses, in the order of `jump`
        self.kicked = [values.inputs.index(n) for n in values.kicked]

    def set_node_inputs(self, u: ArrayLike) -> None:
        """k x nu, or k x all; FMUError if the unit was exported without them."""
        v, u = self._values, np.asarray(u, float)
        v.take_at_nodes(u if u.ndim < 2 else u[:, : v.nu])
        if v.nu:
            self._slave.set(v.u_nodes)
        if v.taken.n and u.shape[1] == self.all:
            v.taken.values[:] = u[:, v.nu : self._sent.min(initial=self.all)].ravel()
            self._slave.set(v.taken)

    def node_output(self) -> Array:
        """k x all."""
        v, k = self._values, len(self._face.nodes)
        y = self._slave.get(v.y_nodes).reshape(k, v.nu) * v.output_sign
        if self.all == v.nu:
            return y
        found = np.zeros((k, self.all))
        found[:, : v.nu] = y
        if v.sent.n:
            found[:, self._sent] = self._slave.get(v.sent).reshape(k, len(self._sent))
        return found

    @cached_property
    def impulse_ports(self) -> tuple[PortImpulse, ...]:
        """The use of impulses by the ports; empty for a unit without."""
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
        """The sensitivity at nodes, as engines give it; states of a unit are not known, and `end` needs a unit with impulses.

        StepFailure NO_SENSITIVITY if the unit refuses.
        """
        v, k = self._values, len(self._face.nodes)
        chosen = list(range(v.nu) if inputs is None else inputs)
        known = [self._input(i, j) for i in range(k) for j in chosen]
        known += v.impulses.scalars if impulses else ()
        rows = v.told_end if end else v.told
        try:
            found = np.array([self._slave.derivative(self._derivative(end, rows, s)).copy() for s in known])
        except FMUError as error:
            raise StepFailure(Status.NO_SENSITIVITY, self.name, 0.0, 0.0, tried=str(error)) from error
        found = found.reshape(len(known), rows.n).T
        signs = np.append(v.input_sign, np.ones(self.all - v.nu))
        sign = [np.tile(signs[chosen], k), *[v.input_sign[self.kicked]] * (2 * impulses)]
        found = found / np.concatenate(sign)
        n, m = k * v.nu, k * len(self._sent)
        at_nodes = np.zeros((k, self.all, len(known)))
        at_nodes[:, : v.nu] = found[:n].reshape(k, v.nu, len(known)) * v.output_sign[:, None]
        at_nodes[:, self._sent] = found[n : n + m].reshape(k, len(self._sent), len(known))
        at_end = np.zeros((self.all, len(known)))
        if end:
            at_end[: v.nu] = found[n + m :] * v.output_sign[:, None]
        return NodeSensitivity(at_nodes, np.zeros((0, len(known))), at_end if end else None)

    def _input(self, node: int, j: int) -> Scalar:
        """Input j of all at a node."""
        v = self._values
        if j < v.nu:
            return v.u_nodes.scalars[node * v.nu + j]
        return v.taken.scalars[node * len(self._face.taken) + j - v.nu]

    def _derivative(self, end: bool, rows: References, known: Scalar) -> Derivative:
        key = (end, known.name)
        if key not in self._known:
            self._known[key] = Derivative(rows, known, VERSIONS[self._face.version])
        return self._known[key]
