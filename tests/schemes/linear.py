"""Example 6 of the paper: a linear system with an algebraic part."""

from __future__ import annotations

import casadi as ca

from phfmu import (
    PHDAE,
    ClosedPair,
    algebraic,
    block,
    damping,
    energy,
    skew,
    state,
)


def linear() -> PHDAE:
    """x1' = x2, 0 = -x1 - x2, H = x1^2/2 (Example 1)."""
    x1, x2 = state("x1", start=1.0), algebraic("x2", start=-1.0)
    return PHDAE(
        "linear",
        states=(x1,),
        algebraics=(x2,),
        energies=(energy(x1**2 / 2),),
        structure=(skew(x1, x2, 1.0),),
        dissipation=(damping(x2, 1.0),),
    )


def linear_descriptor(ebar=None, zbar=None) -> PHDAE:
    """The same with x = (x1, x2) and the singular E = diag(1, 0) as a gradient pair."""
    x = state("x", 2, start=(1.0, -1.0))
    pair = ClosedPair((x,), x[0] ** 2 / 2, ca.SX([[1.0, 0.0], [0.0, 0.0]]), x.sx, ebar, zbar)
    return PHDAE(
        "linear_descriptor",
        states=(x,),
        closed=(pair,),
        structure=(block([x], ca.SX([[0.0, 1.0], [-1.0, 0.0]])),),
        dissipation=(block([x], ca.diag(ca.SX([0.0, 1.0]))),),
    )
