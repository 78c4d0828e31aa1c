"""Differences f(a') - f(a) of single operations without cancellation, by the rules of differences.

    delta(a b) = b' delta a + a delta b,      delta(a^2) = (a + a') delta a,      delta(1 / a) = -delta a / (a a'),   ..

Source: T. W. Reps, L. B. Rall, Computational divided differencing, Higher-Order Symb. Comput. 16 (2003).
"""

from __future__ import annotations

import casadi as ca

from phfmu.declare.expressions.operations import operation
from phfmu.gradients.quadrature import gauss

#: below this change of its argument a function without a rule is the integral of its derivative by 4 Gauss points
NEAR = 1e-2


def change(op: int, old: list[ca.SX], now: list[ca.SX], by: list[ca.SX]) -> ca.SX:
    """f(now) - f(old) of the analytic operation f = `op`, with the arguments at both ends and their differences."""
    if all(d.is_zero() for d in by):
        return ca.SX(0)
    f, f1 = operation(op, old), operation(op, now)
    a, a1, da = old[0], now[0], by[0]
    if len(old) == 1:
        return _unary(op, a, a1, da, f, f1)
    b, b1, db = old[1], now[1], by[1]
    if op == ca.OP_ADD:
        return da + db
    if op == ca.OP_SUB:
        return da - db
    if op == ca.OP_MUL:
        return b1 * da + a * db
    if op == ca.OP_DIV:
        return (da - f * db) / b1
    if op in (ca.OP_POW, ca.OP_CONSTPOW) and db.is_zero():
        return _relative(a, da, f1 - f, lambda r: f * ca.expm1(b * ca.log1p(r)))
    if op == ca.OP_HYPOT:
        return quotient((a + a1) * da + (b + b1) * db, f + f1, ca.SX(0))
    return f1 - f


def _unary(op: int, a: ca.SX, a1: ca.SX, d: ca.SX, f: ca.SX, f1: ca.SX) -> ca.SX:
    if op == ca.OP_NEG:
        return -d
    if op == ca.OP_TWICE:
        return 2 * d
    if op == ca.OP_SQ:
        return (a + a1) * d
    if op == ca.OP_INV:
        return -d * f * f1
    if op == ca.OP_SQRT:
        return quotient(d, f + f1, ca.SX(0))
    if op == ca.OP_LOG:
        return ca.log1p(d / a)
    if op == ca.OP_LOG1P:
        return ca.log1p(d / (1 + a))
    s = ca.SX.sym("s")
    slope = ca.gradient(operation(op, [s]), s)
    total = sum((w * ca.substitute(slope, s, a + t * d) for t, w in zip(*gauss(4), strict=True)), ca.SX(0))
    return ca.if_else(ca.fabs(d) < NEAR, total * d, f1 - f)


def _relative(a: ca.SX, da: ca.SX, plain: ca.SX, near) -> ca.SX:
    """near(da / a) where that is small, else the plain difference."""
    small = ca.fabs(da) < ca.fabs(a) / 2
    return ca.if_else(small, near(ca.if_else(small, da / ca.if_else(small, a, 1), 0)), plain)


def quotient(num: ca.SX, den: ca.SX, other: ca.SX) -> ca.SX:
    """num / den, `other` where den is 0."""
    there = ca.ne(den, 0)
    return ca.if_else(there, num / ca.if_else(there, den, 1), other)
