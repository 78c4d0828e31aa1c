"""Operations of expressions: which are analytic, what is piecewise in its variables, the degree of polynomials."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf
from typing import NamedTuple

import casadi as ca

#: operations of analytic functions: what holds at points chosen at random holds everywhere
ANALYTIC = frozenset(
    {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG, ca.OP_SQ,
     ca.OP_TWICE, ca.OP_INV, ca.OP_SQRT, ca.OP_EXP, ca.OP_LOG, ca.OP_SIN, ca.OP_COS, ca.OP_TAN, ca.OP_TANH,
     ca.OP_POW, ca.OP_CONSTPOW, ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN, ca.OP_SINH, ca.OP_COSH, ca.OP_LOG1P, ca.OP_EXPM1,
     ca.OP_HYPOT, ca.OP_ERF, ca.OP_ASINH, ca.OP_ACOSH, ca.OP_ATANH}
)  # fmt: skip

#: names of the others; comparisons and their logic are named by what they choose
_NAMES = {
    ca.OP_FABS: "fabs", ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax", ca.OP_IF_ELSE_ZERO: "if_else", ca.OP_SIGN: "sign",
    ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_FMOD: "fmod", ca.OP_REMAINDER: "remainder",
    ca.OP_COPYSIGN: "copysign", ca.OP_ATAN2: "atan2",
}  # fmt: skip
#: comparisons and their logic
TESTS = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR}


class Instruction(NamedTuple):
    """One operation of a scalar function: places of its arguments and result; `value` of a constant.

    An input has its (argument, entry) as `inputs`; an output has its (result, entry) as `outputs`.
    """

    op: int
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    value: float


def instructions(f: ca.Function) -> Iterator[Instruction]:
    """The operations of `f` in order; places of a work vector are used again."""
    for i in range(f.n_instructions()):
        op = f.instruction_id(i)
        value = f.instruction_constant(i) if op == ca.OP_CONST else 0.0
        yield Instruction(op, tuple(f.instruction_input(i)), tuple(f.instruction_output(i)), value)


def function_of(expr: ca.SX, x: ca.SX) -> tuple[ca.Function, ca.SX]:
    """`expr` as a function of x and of its other symbols, and these."""
    own = {s.element_hash() for s in ca.vertsplit(x)}
    rest = ca.vertcat(ca.SX(0, 1), *(s for s in ca.symvar(expr) if s.element_hash() not in own))
    return ca.Function("f", [x, rest], [expr]), rest


def analytic(exprs: Sequence[ca.SX]) -> bool:
    """True if no operation in the expressions is in pieces, in whatever symbol."""
    f = ca.Function("f", ca.symvar(ca.vertcat(ca.SX(0, 1), *exprs)), list(exprs))
    return {f.instruction_id(i) for i in range(f.n_instructions())} <= ANALYTIC


def piecewise(expr: ca.SX, x: ca.SX) -> tuple[str, ...]:
    """Names of the operations in `expr` that are not analytic in x: at them it may have kinks, or jump."""
    f, _ = function_of(expr, x)
    depends, found, tests = [False] * f.sz_w(), dict[str, None](), False
    for n in instructions(f):
        if n.op == ca.OP_INPUT:
            depends[n.outputs[0]] = n.inputs[0] == 0
        elif n.op == ca.OP_CONST:
            depends[n.outputs[0]] = False
        elif n.op != ca.OP_OUTPUT:
            on = [depends[i] for i in n.inputs]
            if n.op in TESTS:
                tests |= any(on)
            elif n.op not in ANALYTIC and (on[0] if n.op == ca.OP_IF_ELSE_ZERO else any(on)):
                found[_NAMES.get(n.op, f"operation {n.op}")] = None
            for o in n.outputs:
                depends[o] = any(on)
    return tuple(found) or (("a comparison",) if tests else ())


def switches(expr: ca.SX, x: ca.SX) -> ca.SX:
    """The piece of `expr` that applies at x, as numbers (n x 1) that change only where pieces meet."""
    f, rest = function_of(expr, x)
    held: dict[int, ca.SX] = {}
    found = [ca.SX(0)]
    for n in instructions(f):
        if n.op == ca.OP_INPUT:
            held[n.outputs[0]] = (x if n.inputs[0] == 0 else rest)[n.inputs[1]]
        elif n.op == ca.OP_CONST:
            held[n.outputs[0]] = ca.SX(n.value)
        elif n.op != ca.OP_OUTPUT:
            given = [held[i] for i in n.inputs]
            value = held[n.outputs[0]] = operation(n.op, given)
            a, b = given[0], given[-1]
            if n.op in TESTS or n.op in (ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL):
                found.append(value)
            elif n.op in (ca.OP_FABS, ca.OP_COPYSIGN):
                found += [a >= 0, b >= 0]
            elif n.op in (ca.OP_FMAX, ca.OP_FMIN):
                found.append(a >= b)
            elif n.op == ca.OP_IF_ELSE_ZERO:
                found.append(ca.ne(a, 0))
            elif n.op in (ca.OP_FMOD, ca.OP_REMAINDER):
                found.append(ca.floor((a - value) / b + 0.5))
            elif n.op == ca.OP_ATAN2:
                found += [a >= 0, b >= 0]
    return ca.vertcat(*found)


def operation(op: int, given: list[ca.SX]) -> ca.SX:
    """The operation `op` of one or two scalars."""
    return ca.SX.binary(op, *given) if len(given) == 2 else ca.SX.unary(op, *given)


def degree(expr: ca.SX, x: ca.SX, most: int = 8) -> int | None:
    """Degree of `expr` as a polynomial in x, or None if it is not one of degree <= `most`.

    By its operations, so that what is a polynomial in pieces is none.
    """
    f = ca.Function("f", [x], [expr], {"allow_free": True})  # other symbols are of degree 0
    of: list[float] = [0.0] * f.sz_w()
    constant, result = [0.0] * f.sz_w(), 0.0
    for n in instructions(f):
        if n.op == ca.OP_OUTPUT:
            result = max(result, of[n.inputs[0]])
            continue
        given = [] if n.op in (ca.OP_INPUT, ca.OP_CONST) else [of[i] for i in n.inputs]
        if n.op == ca.OP_INPUT:
            new = float(n.inputs[0] == 0)
        else:
            new = degree_of(n, given, [constant[i] for i in n.inputs] if n.op != ca.OP_CONST else [])
        for o in n.outputs:
            of[o], constant[o] = new, n.value if n.op == ca.OP_CONST else inf
    return int(result) if result <= most else None


def degree_of(n: Instruction, given: list[float], constant: list[float]) -> float:
    """Degree of the result of one operation; inf if it is no polynomial.

    Of its arguments `given` are the degrees and `constant` the values, inf for what is not a number.
    """
    if not any(given):
        return 0.0
    if n.op in (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG, ca.OP_TWICE, ca.OP_ASSIGN):
        return max(given)
    if n.op == ca.OP_MUL:
        return sum(given)
    if n.op == ca.OP_SQ:
        return 2 * given[0]
    if n.op == ca.OP_DIV and not given[1]:
        return given[0]
    if n.op == ca.OP_IF_ELSE_ZERO and not given[0]:
        return given[1]
    if n.op in (ca.OP_POW, ca.OP_CONSTPOW):
        power = constant[1]
        return given[0] * power if power >= 0 and float(power).is_integer() else inf
    return inf
