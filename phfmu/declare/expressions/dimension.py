"""Dimensions of expressions: what unit follows from the units of the symbols.

A walk over the instructions of a CasADi expression.  Sums, minima and comparisons need equal dimensions, products and
powers make new ones, transcendental functions need a dimensionless argument (rad = 1).  Numbers: a summand takes the
dimension of what it is added to.  A factor such as 1/2, 2 pi or sqrt(3) has none; any other (9.81, 1e-3) may be a quantity
or a conversion, and what it multiplies is not judged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from math import isclose, pi, sqrt

import casadi as ca

from phfmu.declare.expressions.units import BASE, UnitError, parse_unit, unit_text

#: factors of units that differ by less are the same
CLOSE = 1e-9
#: numbers that formulas are made of
SMALL = (1, 2, 3, 4, 6, 8, 12, 16, 24)
CONSTANTS = (1.0, pi, sqrt(2.0), sqrt(3.0), pi * pi)


@dataclass(frozen=True)
class Dimension:
    """Exponents of the SI base units (rad = 1), factor to SI, and the numbers the expression was multiplied by.

    `quantity`: one of them may have a unit
    """

    exponents: tuple[Fraction, ...] = (Fraction(0),) * (len(BASE) - 1)
    factor: float = 1.0
    numbers: frozenset[float] = frozenset()
    quantity: bool = False

    def times(self, other: Dimension, power: int = 1) -> Dimension:
        exponents = tuple(a + power * b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Dimension(
            exponents, self.factor * other.factor**power, self.numbers | other.numbers, self.quantity or other.quantity
        )

    def to_the(self, power: Fraction) -> Dimension:
        exponents = tuple(e * power for e in self.exponents)
        return Dimension(exponents, self.factor ** float(power), self.numbers, self.quantity)

    def fits(self, other: Dimension) -> bool:
        """Equal exponents and factors, or a number in one of them that may make up for the difference."""
        same = self.exponents == other.exponents and isclose(self.factor, other.factor, rel_tol=CLOSE)
        return same or self.quantity or other.quantity

    @property
    def pure(self) -> bool:
        """Dimensionless, in radian if it is an angle."""
        return self.fits(NONE)

    def __str__(self) -> str:
        return unit_text(self.exponents, self.factor)


NONE = Dimension()
JOULE = Dimension(tuple(map(Fraction, parse_unit("J").without_angle())))
SECOND = Dimension(tuple(map(Fraction, parse_unit("s").without_angle())))
WATT = JOULE.times(SECOND, -1)


def of_unit(text: str) -> Dimension:
    """The dimension of a unit; UnitError if it is not known."""
    unit = parse_unit(text)
    return Dimension(tuple(map(Fraction, unit.without_angle())), unit.factor)


def constraint_unit(multiplier: str) -> str:
    """The unit of g whose multiplier is in `multiplier`: their product is an energy; "1" if it has no name."""
    try:
        text = str(JOULE.times(of_unit(multiplier), -1))
        return parse_unit(text).text
    except UnitError:
        return "1"


@dataclass(frozen=True)
class Number:
    """A number: as a summand it may have any unit."""

    value: float


#: what is known of a part of an expression; None: nothing
Known = Dimension | Number | None


@dataclass
class DimensionAnalysis:
    """Dimensions of the nonzero entries of `expr`; `clashes`: what does not fit inside it, in words."""

    expr: ca.SX
    symbols: Mapping[int, Dimension | None]
    clashes: list[str] = field(default_factory=list)

    def entries(self) -> list[Known]:
        given = ca.symvar(self.expr)
        f = ca.Function("f", [ca.vertcat(*given)] if given else [], [self.expr])
        work: dict[int, Known] = {}
        found: list[Known] = [None] * self.expr.nnz()
        for k in range(f.n_instructions()):
            op, i, o = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
            if op == ca.OP_INPUT:
                work[o[0]] = self.symbols.get(given[i[1]].element_hash())
            elif op == ca.OP_CONST:
                work[o[0]] = Number(f.instruction_constant(k))
            elif op == ca.OP_OUTPUT:
                found[o[1]] = work[i[0]]
            else:
                work[o[0]] = self._made(op, [work[j] for j in i])
        return found

    def _made(self, op: int, args: list[Known]) -> Known:
        if op in _SAME:
            return args[0]
        if op in _COMPARED:
            self._joined(args, "compares")
            return NONE
        if op in _SUMS:
            return self._joined(args, "adds" if op in (ca.OP_ADD, ca.OP_SUB) else "compares")
        if op == ca.OP_IF_ELSE_ZERO:
            return args[1]
        if op in _POWERS:
            return _power(args[0], _POWERS[op])
        if op in (ca.OP_MUL, ca.OP_DIV):
            return _product(args[0], args[1], 1 if op == ca.OP_MUL else -1)
        if op in (ca.OP_POW, ca.OP_CONSTPOW):
            return self._raised(args[0], args[1])
        if op == ca.OP_ATAN2:
            self._joined(args, "compares")
            return NONE
        if op in _FUNCTIONS:
            return self._function(_FUNCTIONS[op], args[0])
        return None

    def _joined(self, args: list[Known], verb: str) -> Known:
        a, b = args
        if isinstance(a, Number) or isinstance(b, Number):
            return b if isinstance(a, Number) else a
        if a is None or b is None:
            return None
        if not a.fits(b):
            self.clashes.append(f"it {verb} {a} and {b}{counted_numbers(a, b)}")
            return None
        return Dimension(a.exponents, a.factor, a.numbers | b.numbers, a.quantity or b.quantity)

    def _raised(self, base: Known, exponent: Known) -> Known:
        if isinstance(exponent, Number):
            return _power(base, Fraction(exponent.value).limit_denominator(1000))
        if exponent is None or base is None:
            return None
        if not exponent.pure:
            self.clashes.append(f"it has an exponent in {exponent}{counted_numbers(exponent)}")
        if isinstance(base, Dimension) and not base.pure:
            self.clashes.append(f"it raises {base} to a power that is not a number{counted_numbers(base)}")
        return NONE

    def _function(self, name: str, arg: Known) -> Known:
        if isinstance(arg, Dimension) and not arg.pure:
            self.clashes.append(f"it takes {name} of {arg}{counted_numbers(arg)}")
        return arg if isinstance(arg, Number) else NONE


def _product(a: Known, b: Known, power: int) -> Known:
    if a is None or b is None:
        return None
    if isinstance(a, Number) and isinstance(b, Number):
        return Number(a.value * b.value**power if b.value or power > 0 else 0.0)
    return _factor(a).times(_factor(b), power)


def _factor(known: Dimension | Number) -> Dimension:
    if isinstance(known, Dimension):
        return known
    return Dimension(numbers=frozenset({abs(known.value)}), quantity=not _plain(known.value))


def _plain(value: float) -> bool:
    """A fraction of small numbers, perhaps times pi or a root: no one's measured quantity."""
    sizes = (abs(value) / c for c in CONSTANTS)
    return value == 0 or any(isclose(s, n / d, rel_tol=1e-12) for s in sizes for n in SMALL for d in SMALL)


def _power(base: Known, power: Fraction) -> Known:
    if base is None:
        return None
    if isinstance(base, Number):
        return Number(abs(base.value) ** float(power) if base.value or power > 0 else 0.0)
    return base.to_the(power)


def counted_numbers(*dimensions: Dimension) -> str:
    """A word about numbers that may hide a unit."""
    numbers = sorted({n for d in dimensions for n in d.numbers} - {0.5, 1.0, 2.0})
    if not numbers:
        return ""
    shown = ", ".join(f"{n:g}" for n in numbers[:4])
    return f" (the number{'s' if len(numbers) > 1 else ''} {shown} counted as dimensionless)"


_SAME = {
    ca.OP_ASSIGN,
    ca.OP_NEG,
    ca.OP_FABS,
    ca.OP_FLOOR,
    ca.OP_CEIL,
    ca.OP_COPYSIGN,
    ca.OP_LIFT,
    ca.OP_TWICE,
    ca.OP_FMOD,
}
_SUMS = {ca.OP_ADD, ca.OP_SUB, ca.OP_FMIN, ca.OP_FMAX, ca.OP_HYPOT}
_COMPARED = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE}
_POWERS = {ca.OP_SQ: Fraction(2), ca.OP_SQRT: Fraction(1, 2), ca.OP_INV: Fraction(-1), ca.OP_SIGN: Fraction(0)}
_FUNCTIONS = {
    getattr(ca, f"OP_{n.upper()}"): n
    for n in ("exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh",
              "atanh", "erf", "erfinv", "expm1", "log1p")
    if hasattr(ca, f"OP_{n.upper()}")
}  # fmt: skip
