"""Discrete gradients of one energy term at the k Gauss nodes of a step.

With increments D_i (x' = x + sum b_i D_i, D_i = h F_i) every function here returns node gradients W_i and the
energy difference dH such that the directionality condition

    sum_i b_i D_i^T W_i = H(x') - H(x) = dH

holds exactly: this is the only property the power balance needs.  k = 1 gives discrete gradients in the sense of
Gonzalez (J. Nonlinear Sci. 6, 1996).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from phfmu.declare.expressions.operations import degree
from phfmu.gradients.quadrature import Nodes, gauss
from phfmu.gradients.secants import secants

#: Threshold on |dx|^2 of quotients with a plain difference as numerator.
QUOTIENT_GUARD = 1e-12
#: The same of quotients whose numerator has no cancellation: only 0/0 and its underflow are kept out, so that the balance
#: is exact whatever the units of the states are.
SMALLEST = 1e-100
#: What rounding leaves of a defect whose parts are summed without cancellation.
NOISE = 16 * np.finfo(float).eps

Gradient = tuple[ca.SX, ca.SX]


def at(expr: ca.SX, x: ca.SX, value: ca.SX) -> ca.SX:
    """`expr` with x replaced by `value`."""
    return ca.substitute(expr, x, value)


def _point(x: ca.SX, d: ca.SX, nd: Nodes, t: float) -> ca.SX:
    return x + ca.mtimes(d, ca.DM(nd.integral(t)))


def quadratic(h: ca.SX, z: ca.SX, x: ca.SX, d: ca.SX, nd: Nodes) -> Gradient:
    """H with constant Hessian: Z_i = z(X_i) with z = E^-T grad H given; dH = grad H((x + x')/2)^T (x' - x)."""
    w = [at(z, x, x + ca.mtimes(d, ca.DM(nd.a[i]))) for i in range(nd.k)]
    step = ca.mtimes(d, ca.DM(nd.b))
    return ca.horzcat(*w), ca.dot(at(ca.gradient(h, x), x, x + step / 2), step)


def nodal(h: ca.SX, x: ca.SX, d: ca.SX, nd: Nodes) -> Gradient:
    """Gradients at the nodes, uncorrected (Gauss collocation; k = 1 is the midpoint rule MP): dH is H(x') - H(x)."""
    grad = ca.gradient(h, x)
    w = [at(grad, x, x + ca.mtimes(d, ca.DM(nd.a[i]))) for i in range(nd.k)]
    return ca.horzcat(*w), difference(h, x, ca.mtimes(d, ca.DM(nd.b)))


def difference(h: ca.SX, x: ca.SX, step: ca.SX) -> ca.SX:
    """H(x + step) - H(x) without the cancellation: of a polynomial by its path integral, else summed by operations."""
    smooth = secants(h, x, x, step)
    if smooth.degree is None:
        return smooth.back(smooth.change)[0]
    slope = ca.gradient(smooth.expr, x)
    along = ((at(slope, x, x + t * step), w) for t, w in zip(*gauss(max(1, -(-smooth.degree // 2))), strict=True))
    return smooth.back(sum((w * ca.dot(g, step) for g, w in along), ca.SX(0)))[0]


def numerical_loss(h: ca.SX, x: ca.SX, d: ca.SX, w: ca.SX, dh: ca.SX, nd: Nodes) -> ca.SX:
    """sum_i b_i D_i^T W_i - dH of node gradients: what the directionality condition misses.

    Quadratic H: 1/2 sum_ij m_ij D_i^T H'' D_j with M = BA + A^T B - b b^T, without cancellation; M >= 0 for Radau IIA.
    """
    if degree(h, x) not in (0, 1, 2):
        return sum((nd.b[i] * ca.dot(d[:, i], w[:, i]) for i in range(nd.k)), ca.SX(0)) - dh
    m = nd.b[:, None] * nd.a
    m = m + m.T - np.outer(nd.b, nd.b)
    turned = ca.horzcat(*(ca.jtimes(ca.gradient(h, x), x, d[:, j]) for j in range(nd.k)))
    pairs = ((i, j) for i in range(nd.k) for j in range(nd.k))
    return sum((0.5 * m[i, j] * ca.dot(d[:, i], turned[:, j]) for i, j in pairs), ca.SX(0))


def general(h: ca.SX, x: ca.SX, d: ca.SX, nd: Nodes, metric: np.ndarray) -> Gradient:
    """W_i = 1/b_i sum_q w_q l_i(t_q) grad H(x(t_q)) + alpha metric D_i with m Gauss points.

    Polynomial H of degree p: m = ceil(p k / 2) makes alpha vanish.  Else m = k + 2 and alpha closes the balance.  Kinks
    of H are replaced by their secants over the step.
    `metric`: nonnegative weights of the states that take the correction.
    """
    step = ca.mtimes(d, ca.DM(nd.b))
    smooth = secants(h, x, x, step)
    grad, p = ca.gradient(smooth.expr, x), smooth.degree
    m = max(1, -(-p * nd.k // 2)) if p is not None else nd.k + 2
    w = projected([at(grad, x, _point(x, d, nd, t)) for t in gauss(m)[0]], m, nd)
    if p is not None:
        # the path integral of the same quadrature: H(x') - H(x) without the cancellation
        dh = sum((nd.b[i] * ca.dot(d[:, i], w[:, i]) for i in range(nd.k)), ca.SX(0))
    else:
        dh = smooth.change
        w = _corrected(w, dh, d, nd, metric)
    w, dh = smooth.back(w, dh)
    return w, dh


def projected(values: list[ca.SX], m: int, nd: Nodes) -> ca.SX:
    """Project the integrand given at m Gauss points on the Lagrange basis of the nodes."""
    t, w = gauss(m)
    columns = []
    for i in range(nd.k):
        total = ca.SX(values[0].numel(), 1)
        for q in range(m):
            total += w[q] * nd.value(t[q])[i] / nd.b[i] * values[q]
        columns.append(total)
    return ca.horzcat(*columns)


def _corrected(w: ca.SX, dh: ca.SX, d: ca.SX, nd: Nodes, metric: np.ndarray) -> ca.SX:
    """Node gradients with the correction that closes the balance, for a dH without cancellation."""
    md = ca.mtimes(ca.diag(ca.DM(metric)), d)
    work = sum((nd.b[i] * ca.dot(d[:, i], w[:, i]) for i in range(nd.k)), ca.SX(0))
    den = sum((nd.b[i] * ca.dot(d[:, i], md[:, i]) for i in range(nd.k)), ca.SX(0))
    return w + guarded(significant(dh, work), den, SMALLEST) * md


def significant(a: ca.SX, b: ca.SX) -> ca.SX:
    """a - b, and 0 where it is rounding: its derivative over a short step would be noise."""
    return ca.if_else(ca.fabs(a - b) > NOISE * (ca.fabs(a) + ca.fabs(b)), a - b, 0)


def guarded(num: ca.SX, den: ca.SX, guard: float) -> ca.SX:
    """num / den where den > guard, else 0; finite in value and derivative on both sides."""
    active = den > guard
    return ca.if_else(active, num / ca.if_else(active, den, 1), 0)


def strain(c: ca.SX, phi: ca.SX, s: ca.SX, x: ca.SX, d: ca.SX, nd: Nodes) -> Gradient:
    """H = phi(C(x)), C quadratic: W_i = S_i grad C(X_i), with the strain carried as an energy variable.

    Cd_i = grad C(X_i)^T D_i,  Chat(t) = C(x) + sum_j (int_0^t l_j) Cd_j,  S_i = 1/b_i sum_q w_q l_i phi'(Chat(t_q)).
    `phi` is an expression of the scalar symbol `s`.  Linear and angular momentum maps of C are kept.
    """
    grad_c = ca.gradient(c, x)
    g = [at(grad_c, x, x + ca.mtimes(d, ca.DM(nd.a[i]))) for i in range(nd.k)]
    cd = ca.horzcat(*(ca.dot(g[i], d[:, i]) for i in range(nd.k)))
    step = ca.mtimes(d, ca.DM(nd.b))
    node, dh = stress(phi, s, c, cd, nd, ca.dot(at(grad_c, x, x + step / 2), step))
    return ca.horzcat(*(node[i] * g[i] for i in range(nd.k))), dh


def stress(phi: ca.SX, s: ca.SX, c: ca.SX, cd: ca.SX, nd: Nodes, change: ca.SX | None = None) -> Gradient:
    """Node stresses S_i (1 x k) of phi(C) along the path with C = c at its start and increments cd (1 x k); dH.

    `change`: C(x') - C(x), default sum b_i cd_i.  Polynomial phi: dH by its Taylor series, without cancellation.
    """
    total = ca.mtimes(cd, ca.DM(nd.b))
    change = total if change is None else change
    smooth = secants(phi, s, c, change)
    dphi = ca.gradient(smooth.expr, s)

    def chat(t: float) -> ca.SX:
        return c + ca.mtimes(cd, ca.DM(nd.integral(t)))

    p = smooth.degree
    m = max(1, -(-p * nd.k // 2)) if p is not None else nd.k + 2
    node = projected([at(dphi, s, chat(t)) for t in gauss(m)[0]], m, nd)
    if p is not None:
        dh = _difference(smooth.expr, s, c, change, p)
    else:
        # closed for the increments along which the stresses work: in a rotation they are rounding, and so is what is
        # between them and `change`
        closing, dh = secants(phi, s, c, total).change, smooth.change
        node = _corrected(node, closing, cd, nd, np.ones(1))
    node, dh = smooth.back(node, dh)
    return node, dh


def _difference(phi: ca.SX, s: ca.SX, c: ca.SX, change: ca.SX, p: int) -> ca.SX:
    """phi(c + change) - phi(c) of a polynomial of degree p, by Horner's scheme on its Taylor coefficients."""
    coefficients, g = [], phi
    for n in range(1, p + 1):
        g = ca.gradient(g, s) / n
        coefficients.append(at(g, s, c))
    total = ca.SX(0)
    for coefficient in reversed(coefficients):
        total = (coefficient + total) * change
    return total


def joint_gonzalez(h: ca.SX, x: ca.SX, d: ca.SX, nd: Nodes) -> Gradient:
    """The seed's gradient over all of x (k = 1): W = grad H(m) + (dH - grad H(m)^T D)/|D|^2 D.

    The numerator has no cancellation near x' = x.  Polynomial H: the exact odd Taylor remainder
    sum_j D^jH(m)[D..D]/(2^(j-1) j!), j = 3, 5, ..; else from the change of H, summed without cancellation.
    """
    if nd.k != 1:
        raise ValueError(
            "the joint Gonzalez gradient exists for order 2 only; use the per-term gradient for order 4 or 6"
        )
    m, length2 = x + d / 2, ca.dot(d, d)
    smooth = secants(h, x, x, d)
    h = smooth.expr
    slope = ca.gradient(h, x)
    grad, p = at(slope, x, m), smooth.degree
    if p is not None:
        num = _taylor_remainder(h, x, d, m, p)
    else:
        num = significant(smooth.change, ca.dot(grad, d))
    w, dh = smooth.back(grad + guarded(num, length2, SMALLEST) * d, num + ca.dot(grad, d))
    return w, dh


def _taylor_remainder(h: ca.SX, x: ca.SX, d: ca.SX, m: ca.SX, p: int) -> ca.SX:
    t = ca.SX.sym("t")
    g = at(h, x, m + t * d)
    total, factorial = ca.SX(0), 1.0
    for j in range(1, p + 1):
        g = ca.gradient(g, t)
        factorial *= j
        if j >= 3 and j % 2:
            total += at(g, t, ca.SX(0)) / (2.0 ** (j - 1) * factorial)
    return total
