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


@lru_cache(maxsize=1024)
def _tangent(function: ca.Function) -> ca.Function:
    x, y, p = function.sx_in()
    out = function.call([x, y, p])[0]
    dx, dy = ca.SX.sym("dx", x.numel()), ca.SX.sym("dy", y.numel())
    along = ca.densify(ca.jtimes(out, ca.vertcat(x, y), ca.vertcat(dx, dy)))
    (along,) = ca.cse([along])
    return ca.Function("tangent", [x, y, p, dx, dy], [along], {"allow_free": False})


def tangent(kernel: Kernel) -> ca.Function:
    """(x, y, p, dx, dy) -> d out of a kernel."""
    return _tangent(kernel.function)


@lru_cache(maxsize=1024)
def _slope(function: ca.Function) -> ca.Function:
    x, y, p = function.sx_in()
    out = function.call([x, y, p])[0]
    dp = ca.SX.sym("dp", p.numel())
    (along,) = ca.cse([ca.densify(ca.jtimes(out, p, dp))])
    return ca.Function("slope", [x, y, p, dp], [along], {"allow_free": False})


def slope(kernel: Kernel) -> ca.Function | None:
    """(x, y, p, dp) -> d out of a kernel along a direction of its parameters; None for one that has none."""
    return _slope(kernel.function) if kernel.np else None


def differentiated(plan: Plan, reports: bool = False) -> list[Kernel]:
    """Kernels with results that reach the residual or a pair output, with `reports` all rows."""
    rows = plan.nrow if reports else plan.nw + plan.nq * plan.k
    return [g.kernel for g in plan.groups if g.stage == 0 or bool((g.oi < rows).any())]
