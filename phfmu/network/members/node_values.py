"""The interface of a coupling of order 2k to a member: inputs and outputs at the k nodes of a step, impulses at its ends.

A member that takes none of that takes the mean of its inputs, held over the step, as the one value of a step with one node.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.phdae import PHDAE
from phfmu.engine.impulses import PortKernels, port_kernels
from phfmu.gradients.quadrature import Nodes, gauss_nodes, nodes
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.member import Member
from phfmu.terms.port_impulses import PortImpulse

if TYPE_CHECKING:
    from phfmu.fmu.importer.ports.node_exchange import NodeExchange
    from phfmu.network.members.fmu_member import FMUMember

Array = NDArray[np.float64]


class Offer(Protocol):
    """The use of impulses by a member's ports: by port name, and the inputs that take some, in the order of `jump`."""

    name: str

    @property
    def ports(self) -> dict[str, PortImpulse]: ...
    @property
    def kicked(self) -> list[int]: ...

    def jump(self) -> Array:
        """S = L^T H'' L now (A/(V s) at electrical ports)."""
        ...


class DeclaredOffer:
    """The offer of a declaration at its start, found out when asked for."""

    def __init__(self, name: str, declaration: PHDAE):
        self.name, self._declaration = name, declaration

    @cached_property
    def _kernels(self) -> PortKernels:
        return port_kernels(self._declaration)

    @property
    def ports(self) -> dict[str, PortImpulse]:
        return {p.port: p for p in self._kernels.forms.ports}

    @property
    def kicked(self) -> list[int]:
        return list(self._kernels.forms.pairs)

    @property
    def places(self) -> dict[str, slice]:
        """Port name -> slice of the `nu` external inputs."""
        return {p.port: slice(p.inputs[0], p.inputs[-1] + 1) for p in self.ports.values()}

    @property
    def nu(self) -> int:
        return sum(len(p.inputs) for p in self.ports.values())

    def jump(self) -> Array:
        d = self._declaration
        x, p = (np.array([a for v in variables for a in v.start], float) for variables in (d.states, d.parameters))
        return np.array(self._kernels.jump(x, p))


class NodeValues(Protocol):
    """A member as a master of order 2k sees it; impulses are those of its offer."""

    @property
    def member(self) -> Member: ...
    @property
    def rule(self) -> Nodes:
        """The nodes of its steps."""
        ...

    @property
    def offer(self) -> Offer | None:
        """None: no impulses."""
        ...

    def step(self, U: Array, impulses: tuple[Array, Array] | None, t: float, h: float) -> Array:
        """Outputs at the nodes (k x nu) of a step with inputs U at them (k x nu), which it takes."""
        ...

    def sensitivity(self, inputs: list[int], kicked: bool) -> tuple[Array, Array | None]:
        """dY (k nu x columns) of the last step with respect to the inputs at node 1, 2, ..., then to impulses; dy_end.

        StepFailure (NO_SENSITIVITY) where the member does not know it.
        """
        ...

    def jump(self) -> Array: ...

    def add_impulse(self, s: Array, state: Any) -> None:
        """One more impulse at the end of the step that it has taken from `state`, which counts as part of it."""
        ...


class UnitOffer:
    """The offer of a unit, as its manifest says."""

    def __init__(self, name: str, unit: NodeExchange):
        self.name, self._unit = name, unit
        self.ports = {p.port: p for p in unit.impulse_ports}
        self.kicked = unit.kicked

    def jump(self) -> Array:
        return self._unit.jump()


class InstanceNodes:
    """Values at nodes of a member whose instance takes them: a collocation engine, or a unit exported with inputs at nodes."""

    def __init__(self, member: EngineMember | FMUMember, rule: Nodes, offer: Offer | None):
        self.member, self.rule, self.offer = member, rule, offer
        self._instance = member.instance if isinstance(member, EngineMember) else member.unit.at_nodes
        self._given: tuple[Array, tuple[Array, Array] | None, float, float] | None = None

    def step(self, U: Array, impulses: tuple[Array, Array] | None, t: float, h: float) -> Array:
        instance = self._instance
        self._given = U, impulses, t, h
        instance.set_node_inputs(U)
        if impulses is not None:
            instance.set_impulses(*impulses)
        self.member.do_step(t, h)
        return instance.node_output()

    def sensitivity(self, inputs: list[int], kicked: bool) -> tuple[Array, Array | None]:
        found = self._instance.node_sensitivity(inputs, impulses=kicked, end=kicked)
        return found.nodes.reshape(self.rule.k * self.member.nu, -1), found.end

    def jump(self) -> Array:
        return self._instance.jump()

    def add_impulse(self, s: Array, state: Any) -> None:
        if isinstance(self.member, EngineMember):
            self.member.instance.add_impulse(s)
            return
        assert self._given is not None
        U, given, t, h = self._given
        if given is not None:  # units know impulses of the coming step only: it is taken again
            self.member.set_state(state)
            self.step(U, (given[0], given[1] + s), t, h)


class HeldNodes:
    """Values of any other member: one node, no impulses."""

    offer: Offer | None = None

    def __init__(self, member: Member):
        self.member, self.rule = member, nodes(1)

    def step(self, U: Array, impulses: tuple[Array, Array] | None, t: float, h: float) -> Array:
        self.member.set_input(U[0])
        self.member.do_step(t, h)
        return self.member.output()[None]

    def sensitivity(self, inputs: list[int], kicked: bool) -> tuple[Array, Array | None]:
        return self.member.sensitivity()[:, inputs], None

    def jump(self) -> Array:
        return np.zeros((0, 0))

    def add_impulse(self, s: Array, state: Any) -> None:
        """It takes none."""


def node_values(member: Member, together: bool = True) -> NodeValues:
    """The most that a member offers; runs without units do not load their reader.

    `together`: whether a member with state events lands together with others; else what happens in its step is in no polynomial.
    """
    if isinstance(member, EngineMember) and member.model.events is not None and not together:
        return HeldNodes(member)
    if isinstance(member, EngineMember) and member.model.modes is not None:
        return InstanceNodes(member, member.model.scheme.nodes, None)
    if isinstance(member, EngineMember) and (scheme := member.model.scheme).node_values:
        offer = DeclaredOffer(member.name, member.model.declaration) if scheme.impulses else None
        return InstanceNodes(member, scheme.nodes, offer)
    if isinstance(member, EngineMember):
        return HeldNodes(member)
    from phfmu.network.members.fmu_member import FMUMember

    if isinstance(member, FMUMember) and (rule := gauss_nodes(member.unit.nodes)):
        return InstanceNodes(
            member, rule, UnitOffer(member.name, member.unit.at_nodes) if member.unit.at_nodes.kicked else None
        )
    return HeldNodes(member)
