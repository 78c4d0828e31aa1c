"""Symmetric compositions of a one-step scheme: orders 4 and 6 from steps of order 2, for comparison.

    Phi_h  ->  Phi_(g_s h) o ... o Phi_(g_1 h),     sum g_i = 1,     g_i = g_(s+1-i).

Above order 2 some g_i are negative (Q. Sheng 1989; M. Suzuki, J. Math. Phys. 32, 1991): a substep back in time gains
what R would dissipate.  So R = 0 is required; with dissipation use collocation, which has order 4 and 6 without.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.discretise.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Composition:
    """Substeps g_i of a step; `order` with a symmetric scheme of order 2."""

    name: str
    order: int
    substeps: tuple[float, ...]


def _symmetric(half: tuple[float, ...]) -> tuple[float, ...]:
    """half, the middle that makes the sum 1, half reversed."""
    return (*half, 1.0 - 2.0 * sum(half), *reversed(half))


#: M. Suzuki, Phys. Lett. A 146 (1990) 319
SUZUKI = Composition("suzuki", 4, _symmetric((1.0 / (4.0 - 4.0 ** (1.0 / 3.0)),) * 2))
#: W. Kahan, R.-C. Li, Math. Comp. 66 (1997) 1089
KAHAN_LI = Composition(
    "kahan-li",
    6,
    _symmetric((0.39216144400731413928, 0.33259913678935943860, -0.70624617255763935981, 0.08221359629355080023)),
)


COMPOSITIONS = {c.name: c for c in (SUZUKI, KAHAN_LI)}


class ComposedSteps:
    """Steps of an instance (Python or native) composed of substeps.  DeclarationError if the model dissipates."""

    def __init__(self, instance: Any, composition: Composition):
        require_lossless(instance.model)
        self.instance, self.composition = instance, composition

    def substeps(self, t: float, h: float) -> Iterator[tuple[float, float]]:
        """(start, length) of the substeps of [t, t + h], taken one after the other; they may leave it and come back."""
        at, g = np.concatenate([[0.0], np.cumsum(self.composition.substeps)]), self.composition.substeps
        for i in range(len(g)):
            self.instance.do_step(t + at[i] * h, g[i] * h)
            yield t + at[i] * h, g[i] * h


def require_lossless(model: Model) -> None:
    """DeclarationError that says what fits instead if R is not zero for the model's parameters."""
    import casadi as ca

    d = model.declaration
    p = ca.vertcat(*(v.sx for v in d.parameters))
    for b in d.dissipation:
        entries = ca.substitute(ca.vec(ca.SX(b.matrix)), p, ca.DM(model.p0)) if p.numel() else ca.vec(ca.SX(b.matrix))
        if not ca.simplify(entries).is_zero():
            names = ", ".join(v.name for v in b.variables)
            fit = "two-level of order 6" if d.constraints else "collocated of order 4 or 6"
            raise DeclarationError(
                d.name,
                f"compositions of order above 2 step backwards, which gains what R on {names} should dissipate",
                f"use the scheme {fit}",
            )
