"""Kinks of a function replaced by their secants over a step: analytic along the step, the same at both of its ends.

A step goes from x to x'.  With a, a' the argument of |a| at both ends,

    |a(y)|  ->  s a(y) + |a| - s a,      s = (|a'| - |a|) / (a' - a) = (a + a') / (|a| + |a'|),

which is |a(y)| itself where a and a' have one sign.  max and min follow from |a - b|; what jumps (comparisons, sign,
floor) becomes affine in what it tests where it differs between the ends, else it stays constant.  The discrete gradients
of the function that results are continuous in x', those of every smooth branch away from kinks, and have its difference
H(x') - H(x) across them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import casadi as ca

from phfmu.declare.expressions.operations import TESTS, degree, function_of, instructions, operation, piecewise
from phfmu.gradients.increments import change, quotient


@dataclass(frozen=True)
class SecantExpression:
    """`expr`, analytic in x, and the symbols of its secants with their values as expressions of the ends of the step.

    `degree`: of `expr` as a polynomial in x, None if it is none;  `by`: its difference over the step, None where it was a
    polynomial from the start.
    """

    expr: ca.SX
    degree: int | None
    symbols: tuple[ca.SX, ...] = ()
    values: tuple[ca.SX, ...] = ()
    by: ca.SX | None = None

    @property
    def change(self) -> ca.SX:
        """The difference over the step of what was no polynomial, summed without cancellation."""
        assert self.by is not None
        return self.by

    def back(self, *exprs: ca.SX) -> list[ca.SX]:
        """The values put for the symbols in expressions made of `expr`."""
        if not self.symbols:
            return list(exprs)
        return ca.substitute(list(exprs), [ca.vertcat(*self.symbols)], [ca.vertcat(*self.values)])


@dataclass(frozen=True)
class _StepValue:
    """A value along the step, at its ends, and their difference; `test`: it is true or false."""

    along: ca.SX
    start: ca.SX
    end: ca.SX
    by: ca.SX
    test: bool = False


def secants(expr: ca.SX, x: ca.SX, start: ca.SX, step: ca.SX) -> SecantExpression:
    """`expr`, a scalar function of x, on the step from `start` to `start + step`; the same expression if it is analytic."""
    p = degree(expr, x)
    if p is not None:
        return SecantExpression(expr, p)
    found = _SecantRules(x, start, step).smooth(expr)
    if not piecewise(expr, x):
        return replace(found, expr=expr)
    return replace(found, degree=degree(found.expr, x))


@dataclass
class _SecantRules:
    """Rules by which the operations of a function are written with secants over a step."""

    x: ca.SX
    start: ca.SX
    step: ca.SX
    symbols: list[ca.SX] = field(default_factory=list)
    values: list[ca.SX] = field(default_factory=list)

    def smooth(self, expr: ca.SX) -> SecantExpression:
        f, rest = function_of(expr, self.x)
        held: dict[int, _StepValue] = {}
        total = _constant(ca.SX(0))
        for n in instructions(f):
            if n.op == ca.OP_OUTPUT:
                total = held[n.inputs[0]]
            elif n.op == ca.OP_INPUT and n.inputs[0] == 0:
                x, start, step = (v[n.inputs[1]] for v in (self.x, self.start, self.step))
                held[n.outputs[0]] = _StepValue(x, start, start + step, step)
            elif n.op == ca.OP_INPUT:
                held[n.outputs[0]] = _constant(rest[n.inputs[1]])
            elif n.op == ca.OP_CONST:
                held[n.outputs[0]] = _constant(ca.SX(n.value))
            else:
                held[n.outputs[0]] = self._result(n.op, [held[i] for i in n.inputs])
        return SecantExpression(total.along, None, tuple(self.symbols), tuple(self.values), total.by)

    def _result(self, op: int, given: list[_StepValue]) -> _StepValue:
        if not any(ca.depends_on(v.along, self.x) for v in given):
            value = operation(op, [v.start for v in given])
            return _StepValue(value, value, value, ca.SX(0), op in TESTS)
        return self._in_pieces(op, given) or _applied(op, *given)

    def _in_pieces(self, op: int, given: list[_StepValue]) -> _StepValue | None:
        """The result of an operation that has kinks or jumps; None for the others."""
        a, b = given[0], given[-1]
        start, end = (operation(op, [getattr(v, where) for v in given]) for where in ("start", "end"))
        if op == ca.OP_FABS:
            return self._modulus(a)
        if op in (ca.OP_FMAX, ca.OP_FMIN):
            return self._extreme(a, b, start, end, 1 if op == ca.OP_FMAX else -1)
        if op == ca.OP_NOT:
            return self._not(self._truth(a))
        if op == ca.OP_AND:
            return _applied(ca.OP_MUL, self._truth(a), self._truth(b), test=True)
        if op == ca.OP_OR:
            neither = _applied(ca.OP_MUL, self._not(self._truth(a)), self._not(self._truth(b)), test=True)
            return self._not(neither)
        if op in TESTS:
            return self._affine(_applied(ca.OP_SUB, a, b), start, end, test=True)
        if op == ca.OP_IF_ELSE_ZERO:
            chosen = _applied(ca.OP_MUL, self._truth(a), b)
            return _StepValue(chosen.along, start, end, chosen.by)
        if op in (ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL):
            return self._affine(a, start, end)
        if op in (ca.OP_FMOD, ca.OP_REMAINDER):
            turns = ((a.start - start) / b.start, (a.end - end) / b.end)
            floors = ca.floor(turns[0] + 0.5), ca.floor(turns[1] + 0.5)
            whole = _applied(ca.OP_MUL, b, self._affine(_applied(ca.OP_DIV, a, b), floors[0], floors[1]))
            rest = _applied(ca.OP_SUB, a, whole)
            return _StepValue(rest.along, start, end, rest.by)
        if op == ca.OP_COPYSIGN:
            sign = self._affine(b, ca.copysign(1, b.start), ca.copysign(1, b.end))
            return _applied(ca.OP_MUL, self._modulus(a), sign)
        return None

    def _modulus(self, a: _StepValue) -> _StepValue:
        """|a| by its secant."""
        start, end = ca.fabs(a.start), ca.fabs(a.end)
        return self._line(a, quotient(a.start + a.end, start + end, ca.SX(0)), start, end)

    def _extreme(self, a: _StepValue, b: _StepValue, start: ca.SX, end: ca.SX, sign: int) -> _StepValue:
        """max (sign 1) and min (-1) as (a + b + sign |a - b|) / 2, each with its own weight: 0 or 1 where nothing changes."""
        apart = _applied(ca.OP_SUB, a, b)
        slope = quotient(apart.start + apart.end, ca.fabs(apart.start) + ca.fabs(apart.end), ca.SX(0))
        first, second = (self._new((1 + side * sign * slope) / 2) for side in (1, -1))
        offset = self._new(sign * (ca.fabs(apart.start) - slope * apart.start) / 2)
        weights = self.values[-3:-1]
        return _StepValue(
            first * a.along + second * b.along + offset, start, end, weights[0] * a.by + weights[1] * b.by
        )

    def _affine(self, a: _StepValue, start: ca.SX, end: ca.SX, test: bool = False) -> _StepValue:
        """The affine function of `a` with these values at the ends; a constant if they are equal."""
        slope = ca.if_else(ca.ne(start, end), quotient(end - start, a.by, ca.SX(0)), 0)
        return replace(self._line(a, slope, start, end), by=end - start, test=test)

    def _line(self, a: _StepValue, slope: ca.SX, start: ca.SX, end: ca.SX) -> _StepValue:
        along = self._new(slope) * a.along + self._new(start - slope * a.start)
        return _StepValue(along, start, end, slope * a.by)

    def _new(self, value: ca.SX) -> ca.SX:
        self.symbols.append(ca.SX.sym("secant"))
        self.values.append(value)
        return self.symbols[-1]

    def _truth(self, a: _StepValue) -> _StepValue:
        """A condition; of a number: whether it is not zero."""
        return a if a.test else self._affine(a, ca.ne(a.start, 0), ca.ne(a.end, 0), test=True)

    def _not(self, a: _StepValue) -> _StepValue:
        return _StepValue(1 - a.along, 1 - a.start, 1 - a.end, -a.by, True)


def _constant(value: ca.SX) -> _StepValue:
    return _StepValue(value, value, value, ca.SX(0))


def _applied(op: int, *given: _StepValue, test: bool = False) -> _StepValue:
    """An analytic operation."""
    start, end, by = ([getattr(v, part) for v in given] for part in ("start", "end", "by"))
    along = operation(op, [v.along for v in given])
    return _StepValue(along, operation(op, start), operation(op, end), change(op, start, end, by), test)
