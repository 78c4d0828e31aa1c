"""Named parameters and inputs of an instance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model

if TYPE_CHECKING:
    from phfmu.network.members.interpolant import Interpolant
    from phfmu.network.scene import Event


@dataclass
class Inputs:
    """Named parameters and inputs of one instance, set one at a time."""

    CARRIED: ClassVar = ("u",)
    instance: Any
    model: Model
    parameters: dict[str, int] = field(init=False)
    inputs: dict[str, int] = field(init=False)
    free: dict[str, list[int]] = field(init=False)

    def __post_init__(self) -> None:
        d = self.model.declaration
        names = [n for v in d.parameters for n in v.names()]
        self.parameters = {n: i for i, n in enumerate(names)}
        self._signals = {n for v in d.parameters if v.signal for n in (v.name, *v.names())}
        free = [(p, n) for p in d.ports if p.external for n in p.input_names()]
        self.inputs = {n: i for i, (p, n) in enumerate(free) if not p.sends}
        self.u = self.model.u0.copy()
        #: name of a free input, or bare name of a vector -> its places in u
        self.free = {n: places(self.inputs, n) for n in with_bare(self.inputs) if not places(self.parameters, n)}

    @property
    def names(self) -> list[str]:
        """Free inputs of ports, then signals."""
        return [*self.inputs, *self._signal_places()]

    @property
    def units(self) -> dict[str, str]:
        """Units of the names."""
        d = self.model.declaration
        ports = {n: p.input_unit for p in d.ports if p.external for n in p.input_names()}
        return ports | {n: v.unit for v in d.parameters if v.signal for n in v.names()}

    def signals(self) -> dict[str, float]:
        """Signals as they are now."""
        p = self.instance.parameters
        return {n: float(p[i]) for n, i in self._signal_places().items()}

    def _signal_places(self) -> dict[str, int]:
        return {n: i for n, i in self.parameters.items() if n in self._signals}

    def rows(self, n: int, changes: Sequence[tuple[int, Event]]) -> NDArray[np.float64]:
        """Inputs of n steps (n x nu) from the present ones on; changes: (number of the step, event), in order."""
        return held_rows(self.u, n, [(self.free[e.name], e.value) for _, e in changes], [k for k, _ in changes])

    def at_nodes(
        self, data: Interpolant, u: NDArray[np.float64], model: Model, t0: float, h: float, first: int
    ) -> NDArray[np.float64]:
        """Inputs of the steps first..first+n-1 of the grid t0 + k h at the nodes of a model (n x k x nu): u (n x nu) held, and
        those that follow the data.
        """
        nodes = model.scheme.nodes
        given = np.repeat(u[:, None], nodes.k, axis=1)
        given[:, :, [self.inputs[n] for n in data.names]] = data.at_nodes(nodes.c, t0, h, len(u), first)
        return given

    def set(self, name: str, value: float) -> str:
        """The kind of value that was set, "parameter" or "input" (of a port, or a signal); "" if `name` is not known.

        The bare name of a vector sets all entries.
        """
        for table in (self.parameters, self.inputs):
            found = places(table, name)
            if not found:
                continue
            if table is self.parameters:
                p = self.instance.parameters
                p[found] = value
                self.instance.set_parameters(p)
                return "input" if name in self._signals else "parameter"
            self.u[found] = value
            self.instance.set_input(self.u)
            return "input"
        return ""


def held_rows(
    start: NDArray[np.float64], n: int, changes: Sequence[tuple[list[int], float]], rows: Sequence[int]
) -> NDArray[np.float64]:
    """n rows that begin as `start`; each change (places, value) holds from its row on, a later one wins."""
    u = np.full((n, len(start)), np.nan)
    u[0] = start
    if all(len(at) == 1 for at, _ in changes):
        u[list(rows), [at[0] for at, _ in changes]] = [value for _, value in changes]
    else:
        for row, (at, value) in zip(rows, changes, strict=True):
            u[row, at] = value
    last = np.maximum.accumulate(np.where(np.isnan(u), 0, np.arange(n)[:, None]), axis=0)
    return np.take_along_axis(u, last, axis=0)


def with_bare(names: Iterable[str]) -> set[str]:
    """Scalar names, and the bare names of vectors."""
    return {known for n in names for known in (n, n.partition("[")[0])}


def places(table: Mapping[str, int], name: str) -> list[int]:
    """Places of `name` in a table of scalar names; the bare name of a vector has those of all its entries."""
    return [i for n, i in table.items() if n == name or n.partition("[")[0] == name]
