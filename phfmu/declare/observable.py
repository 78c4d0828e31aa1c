"""Observables: expressions that a model reports besides its variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from phfmu.declare.elements import element_names
from phfmu.declare.variable import _sx


@dataclass(frozen=True, eq=False)
class Observable:
    """A named expression of x, z, x2, parameters and time that is reported but not integrated.

    `signal`: others may read it;  `elements`: what its entries are called in pictures.
    """

    name: str
    expr: ca.SX
    unit: str = "1"
    description: str = ""
    signal: bool = False
    elements: tuple[str, ...] = ()

    def names(self) -> list[str]:
        """Scalar names, `[1]`-based for vectors."""
        n = self.expr.numel()
        return [self.name] if n == 1 else [f"{self.name}[{j + 1}]" for j in range(n)]


def observable(
    name: str, expr: Any, *, unit: str = "1", description: str = "", elements: Sequence[str] = ()
) -> Observable:
    """A reported expression; a vector expression is named `name[1]`, .., in pictures by `elements`: `name[a]`, ..."""
    made = ca.SX(_sx(expr))
    called = element_names(f"observable '{name}'", elements, made.numel() if made.numel() > 1 else None)
    return Observable(name, made, unit, description, elements=called)
