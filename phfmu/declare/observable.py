"""What a model reports besides its variables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from phfmu.declare.variable import _sx


@dataclass(frozen=True, eq=False)
class Observable:
    """A named expression of x, z, x2, parameters and time that is reported but not integrated; `signal`: others may read it."""

    name: str
    expr: ca.SX
    unit: str = "1"
    description: str = ""
    signal: bool = False

    def names(self) -> list[str]:
        """Scalar names, `[1]`-based for vectors."""
        n = self.expr.numel()
        return [self.name] if n == 1 else [f"{self.name}[{j + 1}]" for j in range(n)]


def observable(name: str, expr: Any, *, unit: str = "1", description: str = "") -> Observable:
    """A reported expression; a vector expression is named `name[1]`, `name[2]`, ..."""
    return Observable(name, ca.SX(_sx(expr)), unit, description)
