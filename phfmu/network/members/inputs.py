"""Named parameters and inputs of an instance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.network.junctions.signal_ports import is_sent

if TYPE_CHECKING:
    from phfmu.network.scene import Event


@dataclass
class Inputs:
    """Named parameters and inputs of one instance, set one at a time."""

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
        self.inputs = {n: i for i, (p, n) in enumerate(free) if not is_sent(p)}
        self.u = self.model.u0.copy()
        named = {*self.inputs, *(n.partition("[")[0] for n in self.inputs)}
        #: name of a free input, or bare name of a vector -> its places in u
        self.free = {n: places(self.inputs, n) for n in named if not places(self.parameters, n)}

    @property
    def names(self) -> list[str]:
        """Free inputs of ports, then signals."""
        return [*self.inputs, *self._signal_places()]

    @property
    def units(self) -> dict[str, str]:
        """Of the names."""
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
        u = np.full((n, len(self.u)), np.nan)
        u[0] = self.u
        for k, e in changes:
            u[k, self.free[e.name]] = e.value
        last = np.maximum.accumulate(np.where(np.isnan(u), 0, np.arange(n)[:, None]), axis=0)
        return np.take_along_axis(u, last, axis=0)

    def set(self, name: str, value: float) -> str:
        """What was set, "parameter" or "input" (of a port, or a signal); "" if `name` is not known.

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


def places(table: Mapping[str, int], name: str) -> list[int]:
    """Places of `name` in a table of scalar names; the bare name of a vector has those of all its entries."""
    return [i for n, i in table.items() if n == name or n.partition("[")[0] == name]
