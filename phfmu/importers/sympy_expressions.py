"""SymPy's expressions as CasADi's, symbol by symbol and function by function; SymPy itself is not imported here."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

import casadi as ca

from phfmu.declare.error import DeclarationError

#: SymPy's names of functions of one argument
FUNCTIONS = {
    "sin": ca.sin, "cos": ca.cos, "tan": ca.tan, "asin": ca.asin, "acos": ca.acos, "atan": ca.atan, "sinh": ca.sinh,
    "cosh": ca.cosh, "tanh": ca.tanh, "asinh": ca.asinh, "acosh": ca.acosh, "atanh": ca.atanh, "exp": ca.exp, "log": ca.log,
    "Abs": ca.fabs, "sign": ca.sign, "erf": ca.erf,
}  # fmt: skip
RELATIONS = {
    "StrictLessThan": ca.lt, "LessThan": ca.le, "StrictGreaterThan": ca.gt, "GreaterThan": ca.ge, "Equality": ca.eq,
    "Unequality": ca.ne,
}  # fmt: skip
#: what has no place in a declaration, and the remedy
REMEDIES = {
    "Derivative": "write rates in J, R and B: H, J, R and B are functions of states and parameters",
    "Integral": "evaluate it (.doit()) or make it a state",
    "Heaviside": "a jump has no energy: use Max(x, 0) or Piecewise of equal values at the border",
    "DiracDelta": "an impulse is an event of a scene",
    "floor": "it jumps: use an event of a scene",
    "ceiling": "it jumps: use an event of a scene",
    "ImaginaryUnit": "quantities are real: use real and imaginary parts",
}


class Converter:
    """Expressions over named symbols; DeclarationError names what `entry` has that cannot be converted."""

    def __init__(self, model: str, symbols: Mapping[str, ca.SX]):
        self._model, self._symbols = model, symbols

    def expression(self, entry: str, e: Any) -> ca.SX:
        """A scalar; common parts of one expression are converted once."""
        known: dict[Any, ca.SX] = {}
        for part in _from_leaves(e):
            known[part] = self._converted(entry, part, [known[a] for a in part.args if a in known])
        return known[e]

    def matrix(self, entry: str, m: Any) -> ca.SX:
        """A matrix; zeros are left out."""
        rows, cols = m.shape
        made = ca.SX(rows, cols)
        for r in range(rows):
            for c in range(cols):
                if m[r, c] != 0:
                    made[r, c] = self.expression(f"{entry}[{r + 1}, {c + 1}]", m[r, c])
        return made

    def _converted(self, entry: str, e: Any, args: list[ca.SX]) -> ca.SX:
        kind = type(e).__name__
        if e.is_Symbol:
            return self._symbol(entry, e.name)
        if e.is_number and not e.args:
            return self._number(entry, e)
        if kind == "Add":
            return _folded(lambda a, b: a + b, args)
        if kind == "Mul":
            return _folded(lambda a, b: a * b, args)
        if kind == "Pow":
            return _power(e, args)
        if kind in ("Min", "Max"):
            return _folded(ca.fmin if kind == "Min" else ca.fmax, args)
        if kind == "atan2":
            return ca.atan2(*args)
        if kind in FUNCTIONS and len(args) == 1:
            return FUNCTIONS[kind](args[0])
        if kind in RELATIONS:
            return RELATIONS[kind](*args)
        if kind in ("And", "Or"):
            return _folded(ca.logic_and if kind == "And" else ca.logic_or, args)
        if kind == "Not":
            return ca.logic_not(args[0])
        if kind in ("BooleanTrue", "BooleanFalse"):
            return ca.SX(float(bool(e)))
        if kind == "ExprCondPair":
            return ca.vertcat(*args)
        if kind == "Piecewise":
            return self._pieces(entry, e, args)
        raise self._refused(entry, e, kind)

    def _symbol(self, entry: str, name: str) -> ca.SX:
        if name in self._symbols:
            return self._symbols[name]
        close = get_close_matches(name, list(self._symbols), 3)
        hint = f"did you mean {', '.join(close)}? " if close else ""
        raise DeclarationError(
            f"{self._model}: {entry}", f"symbol '{name}' is no state or parameter",
            f"{hint}list it in `states` or `parameters`, or put in a number (.subs)", "symbol",
        )  # fmt: skip

    def _number(self, entry: str, e: Any) -> ca.SX:
        if not e.is_real or not e.is_finite:
            raise self._refused(entry, e, type(e).__name__)
        return ca.SX(float(e))

    def _pieces(self, entry: str, e: Any, args: list[ca.SX]) -> ca.SX:
        if not (e.args[-1].args[1] == True):  # noqa: E712  (SymPy's own truth)
            raise DeclarationError(f"{self._model}: {entry}", f"{e} has no value where no condition holds",
                                   "end it with (value, True)", "symbol")  # fmt: skip
        value = args[-1][0]
        for pair in reversed(args[:-1]):
            value = ca.if_else(pair[1], pair[0], value)
        return value

    def _refused(self, entry: str, e: Any, kind: str) -> DeclarationError:
        if type(type(e)).__name__ == "UndefinedFunction":
            remedy = f"replace it by a symbol: .subs({e}, Symbol('{kind}'))"
        else:
            remedy = REMEDIES.get(
                kind, f"known are numbers, + * **, Min, Max, Piecewise, atan2, {', '.join(FUNCTIONS)}"
            )
        return DeclarationError(
            f"{self._model}: {entry}", f"'{e}' ({kind}) cannot be part of a declaration", remedy, "symbol"
        )


def _from_leaves(e: Any) -> list[Any]:
    """All parts of an expression, arguments before what is made of them; arguments of what is refused stay out."""
    order, todo, seen = [], [(e, False)], set()
    while todo:
        part, done = todo.pop()
        if done:
            order.append(part)
        elif part not in seen:
            seen.add(part)
            todo.append((part, True))
            opaque = type(type(part)).__name__ == "UndefinedFunction" or type(part).__name__ in REMEDIES
            todo += [] if opaque else [(a, False) for a in part.args]
    return order


def _power(e: Any, args: list[ca.SX]) -> ca.SX:
    base, exponent = e.args
    if exponent.is_Rational and exponent.q == 2:
        root = ca.sqrt(args[0])
        return root if exponent.p == 1 else 1 / root if exponent.p == -1 else root ** int(exponent.p)
    if exponent == -1:
        return 1 / args[0]
    if type(base).__name__ == "Exp1":
        return ca.exp(args[1])
    return args[0] ** args[1]


def _folded(function: Any, args: list[ca.SX]) -> ca.SX:
    value = args[0]
    for a in args[1:]:
        value = function(value, a)
    return value
