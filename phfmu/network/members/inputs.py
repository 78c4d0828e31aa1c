"""Named parameters and inputs of an instance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from phfmu.discretise.model import Model


@dataclass
class Inputs:
    """Named parameters and inputs of one instance, set one at a time."""

    instance: Any
    model: Model
    parameters: dict[str, int] = field(init=False)
    inputs: dict[str, int] = field(init=False)

    def __post_init__(self) -> None:
        d = self.model.declaration
        names = [n for v in d.parameters for n in v.names()]
        self.parameters = {n: i for i, n in enumerate(names)}
        free = [n for p in d.ports if p.external for n in p.input_names()]
        self.inputs = {n: i for i, n in enumerate(free)}
        self.u = self.model.u0.copy()

    def set(self, name: str, value: float) -> str:
        """What was set, "parameter" or "input"; "" if `name` is not known. The bare name of a vector sets all entries."""
        for table in (self.parameters, self.inputs):
            found = places(table, name)
            if not found:
                continue
            if table is self.parameters:
                p = self.instance.parameters
                p[found] = value
                self.instance.set_parameters(p)
                return "parameter"
            self.u[found] = value
            self.instance.set_input(self.u)
            return "input"
        return ""


def places(table: Mapping[str, int], name: str) -> list[int]:
    """Places of `name` in a table of scalar names; the bare name of a vector has those of all its entries."""
    return [i for n, i in table.items() if n == name or n.partition("[")[0] == name]
