"""Coordinate increment (Itoh-Abe) discrete gradients, k = 1.

    W_j = [H(x'_1 .. x'_j, x_j+1 .. x_n) - H(x'_1 .. x'_j-1, x_j .. x_n)] / (x'_j - x_j)
        = int_0^1 d_j H(x'_1 .. x'_j-1, x_j + s d_j, x_j+1 .. x_n) ds,

evaluated as the integral: exact Gauss rules for polynomials, so that no quotient is formed near x' = x.  Order 1; the
mean with the reversed order of coordinates is symmetric and of order 2.
Source: Itoh, Abe, J. Comput. Phys. 76 (1988).
"""

from __future__ import annotations

import casadi as ca

from phfmu.declare.expressions.operations import degree
from phfmu.gradients.gradients import SMALLEST, Gradient, at, guarded, significant
from phfmu.gradients.quadrature import gauss
from phfmu.gradients.secants import secants


def itoh_abe(h: ca.SX, x: ca.SX, d: ca.SX, *, symmetric: bool) -> Gradient:
    """W and dH for H(x) with increments d (n x 1); coordinates in the order of x, or the mean of both orders."""
    n = x.numel()
    w = _ordered(h, x, d, list(range(n)))
    if symmetric:
        w = (w + _ordered(h, x, d, list(range(n - 1, -1, -1)))) / 2
    if degree(h, x) is not None:
        return w, ca.dot(w, d)
    return w, secants(h, x, x, d).change


def _ordered(h: ca.SX, x: ca.SX, d: ca.SX, order: list[int]) -> ca.SX:
    w = ca.SX(x.numel(), 1)
    point = ca.SX(x)
    for j in order:
        w[j] = _divided(h, x, point, d, j)
        point = ca.SX(point)
        point[j] = x[j] + d[j]
    return w


def _divided(h: ca.SX, x: ca.SX, point: ca.SX, d: ca.SX, j: int) -> ca.SX:
    """Divided difference of H in coordinate j from `point` to `point` + d_j e_j."""
    # a function of coordinate j alone, which starts at x_j
    smooth = secants(at(h, x, point), x[j], x[j], d[j])
    slope, p = ca.gradient(smooth.expr, x[j]), smooth.degree
    m = max(1, (p + 1) // 2) if p is not None else 4
    total = ca.SX(0)
    for t, weight in zip(*gauss(m), strict=True):
        total += float(weight) * at(slope, x[j], x[j] + float(t) * d[j])
    if p is not None:
        return smooth.back(total)[0]
    defect = significant(smooth.change, total * d[j])
    return smooth.back(total + guarded(defect * d[j], d[j] ** 2, SMALLEST))[0]
