"""Tangents of kernels: how their results change along a direction of old states and unknowns, or of parameters.

    d out = (d out / d x) dx + (d out / d y) dy,

and along one of parameters,

    d out = (d out / d p) dp,

in forward mode, without a Jacobian. A step map of several internal steps is differentiated with them, see
`engine/reference/chain.py`.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from phfmu.plan.plan import Kernel, Plan


@lru_cache(maxsize=2048)
def _along(function: ca.Function, name: str, moving: tuple[int, ...]) -> ca.Function:
    """(x, y, p, a direction of each moving argument) -> change of the results along these."""
    arguments = function.sx_in()
    (out, *_) = function.call(arguments)
    moved = [arguments[i] for i in moving]
    directions = [ca.SX.sym("d", a.numel()) for a in moved]
    along = ca.densify(ca.jtimes(out, ca.vertcat(*moved), ca.vertcat(*directions)))
    return ca.Function(name, [*arguments, *directions], ca.cse([along]), {"allow_free": False})


def tangent(kernel: Kernel) -> ca.Function:
    """(x, y, p, dx, dy) -> d out of a kernel."""
    return _along(kernel.function, "tangent", (0, 1))


def slope(kernel: Kernel) -> ca.Function | None:
    """(x, y, p, dp) -> d out of a kernel along a direction of its parameters; None for one that has none."""
    return _along(kernel.function, "slope", (2,)) if kernel.np else None


def differentiated(plan: Plan, reports: bool = False) -> list[Kernel]:
    """Kernels with results that reach the residual or a pair output, with `reports` all rows."""
    rows = plan.nrow if reports else plan.nw + plan.nq * plan.k
    return [g.kernel for g in plan.groups if g.stage == 0 or bool((g.oi < rows).any())]
