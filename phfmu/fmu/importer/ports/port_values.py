"""Values of the ports of a unit in the order a master counts them: names, buffers, and what was set last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.unit_interface import UnitInterface
from phfmu.fmu.importer.values import References
from phfmu.fmu.version import VERSIONS

Array = NDArray[np.float64]


class PortValues:
    """nu scalar pairs of all ports: inputs `u`, outputs now `y_end`, as means of a step `y_mean` (None: not told).

    `u_nodes`, `y_nodes`: inputs and outputs at the nodes of a step, node by node; `taken`, `sent`: signals alike; `held`: u was
    set after u_nodes.
    References hold what the unit says; times `input_sign`, `output_sign` (nu) it counts into the component in units of the
    domain, as all arguments and results of methods do.  FMUError names what the unit has not, and what is no pair.
    """

    def __init__(self, interface: UnitInterface, ports: Sequence[PortMap], name: str):
        self.name, self.interface, self.ports = name, interface, tuple(ports)
        self.inputs = [n for p in ports for n in p.inputs]
        self.outputs = [n for p in ports for n in p.outputs]
        means = [n for p in ports for n in p.step_outputs]
        self.input_sign: Array = np.array([p.input_sign for p in ports for _ in p.inputs])
        self.output_sign: Array = np.array([p.output_sign for p in ports for _ in p.inputs])
        #: of the outputs at places `rates`
        self.displacements = [n for p in ports for n in p.displacements]
        self.displacement_sign: Array = np.array([p.displacement_sign for p in ports for _ in p.displacements])
        self.rates = np.flatnonzero([bool(p.displacements) for p in ports for _ in p.inputs])
        self.u = self.group(self.inputs, "input")
        self.y_end = self.group(self.outputs, "output")
        self.y_mean = self.group(means, "output") if len(means) == len(self.inputs) else None
        self.u_nodes = self.group(_in_order(ports, "node_inputs"), "input")
        self.y_nodes = self.group(_in_order(ports, "node_outputs"), "output")
        self.taken, self.sent = (
            self.group([n for node in zip(*told.values(), strict=True) for n in node], what)
            for told, what in ((interface.taken, "input"), (interface.sent, "output"))
        )
        #: what a step makes of the outputs at its nodes, and at its end
        at_nodes = [s.name for r in (self.y_nodes, self.sent) for s in r.scalars]
        self.told, self.told_end = self.group(at_nodes, "output"), self.group([*at_nodes, *self.outputs], "output")
        impulses = self._impulses(ports)
        #: inputs of which impulses are taken; none for ports that are not those of the manifest
        self.kicked = interface.impulses if impulses else ()
        self.impulses = self.group(impulses, "input")
        self.jump = self.group(_triangle(interface.jump, len(self.kicked)), "local variable")
        energies = [n for p in ports for n in p.pair_energies]
        self.pair_energies = self.group(energies if len(energies) == len(self.inputs) else [], "local variable")
        self.held = True
        self._require_pairs(ports)

    def group(self, names: Sequence[str], what: str) -> References:
        """Buffers for variables of the unit; FMUError names those there are not."""
        return References(self.interface.scalars(tuple(names), what), VERSIONS[self.interface.version])

    def _impulses(self, ports: Sequence[PortMap]) -> list[str]:
        """Impulses at the start of a step, then those at its end."""
        of = dict(zip(self.inputs, (i for p in ports for i in p.impulses or ((),) * len(p.inputs)), strict=True))
        pairs = [of.get(n, ()) for n in self.interface.impulses]
        if any(len(p) != 2 for p in pairs):
            return []
        return [pair[end] for end in range(2) for pair in pairs]

    def _require_pairs(self, ports: Sequence[PortMap]) -> None:
        for p in ports:
            if len(p.inputs) != len(p.outputs):
                raise FMUError(f"{self.name}.{p.name}: {len(p.inputs)} inputs but {len(p.outputs)} outputs; give pairs")
        for n in self.inputs:
            if self.interface.variables[n].causality != "input":
                raise FMUError(f"{self.name}: '{n}' is no input but {self.interface.variables[n].causality}")

    @property
    def nu(self) -> int:
        return self.u.n

    def starts(self, given: Mapping[str, float]) -> Array:
        """Inputs (nu) before anyone sets them."""
        declared = [self.interface.variables[n].start or 0.0 for n in self.inputs]
        told = np.array([given.get(n, s) for n, s in zip(self.inputs, declared, strict=True)])
        return self.input_sign * told + 0.0  # no -0

    def begin(self, given: Mapping[str, float]) -> None:
        """Held inputs are those of the start."""
        self.u.values[:], self.held = self.starts(given) / self.input_sign, True

    def inputs_now(self) -> Array:
        """Held inputs (nu)."""
        return self.input_sign * self.u.values

    def given(self) -> Array:
        """A copy of what the next step takes: inputs at its nodes (k x nu), or held ones (1 x nu)."""
        values = self.u.values if self.held else self.u_nodes.values
        return values.reshape(-1, self.nu) * self.input_sign if self.nu else np.zeros((1, 0))

    def take(self, u: ArrayLike) -> None:
        """Inputs (nu) into their buffer."""
        values = np.asarray(u, float)
        if values.shape != (self.nu,) or not np.isfinite(values).all():
            raise ValueError(f"{self.name}: expected {self.nu} finite inputs, got {u}")
        self.u.values[:], self.held = values / self.input_sign, True

    def take_at_nodes(self, u: ArrayLike) -> None:
        """Inputs at the k nodes (k x nu) into theirs; FMUError if the unit was exported without them."""
        # a unit without ports takes none of them
        values, k = np.asarray(u, float), len(self.interface.nodes) if self.u_nodes.n or not self.nu else 0
        if not k:
            raise FMUError(
                f"{self.name}: the unit has no inputs at nodes; export it with --node-inputs and order 4 or 6"
            )
        if values.shape != (k, self.nu) or not np.isfinite(values).all():
            raise ValueError(f"{self.name}: expected {k} x {self.nu} finite inputs, got {u}")
        self.u_nodes.values[:], self.held = (values / self.input_sign).ravel(), False

    def memory(self) -> dict[str, Any]:
        """A copy of what was set."""
        return {"u": self.u.values.copy(), "u_nodes": self.u_nodes.values.copy(), "held": self.held}

    def recall(self, memory: Mapping[str, Any]) -> None:
        self.u.values[:], self.u_nodes.values[:], self.held = memory["u"], memory["u_nodes"], memory["held"]

    def of_steps(self) -> set[str]:
        """Values that a master exchanges in a step, beside inputs, outputs and means."""
        return {s.name for r in (self.y_nodes, self.sent, self.jump, self.pair_energies) for s in r.scalars}

    def others(self) -> list[str]:
        """Inputs that belong to no port."""
        groups = (self.u_nodes, self.taken, self.impulses)
        own = {*self.inputs, *(s.name for r in groups for s in r.scalars)}
        return [n for n, v in self.interface.variables.items() if v.causality == "input" and n not in own]


def _triangle(name: str, n: int) -> list[str]:
    """Names of the lower triangle of a matrix, row by row."""
    return [f"{name}[{i + 1},{j + 1}]" for i in range(n) for j in range(i + 1)]


def _in_order(ports: Sequence[PortMap], field: str) -> list[str]:
    """Names at the nodes, node by node, in the order of the pairs."""
    pairs = [names for p in ports for names in getattr(p, field)]
    return [name for node in zip(*pairs, strict=True) for name in node]
