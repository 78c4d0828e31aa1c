"""Numbers of a run that are derived: KIND(EXPRESSION), EXPRESSION@TIME, sums of squares against data.

An expression is arithmetic on signals, `gen.w`, `line.i^2`, `gen.w[1] - gen.w[2]`, with + - * / ^, numbers and the functions of
`FUNCTIONS`.  Kinds are first, last, min, max, peak, mean, rms of the rows and `integral` over time by the trapezoidal rule; a
time between two rows is on the line between them, and `end` is the last row.  A measure m of rows y_i has weights
c_i = dm/dy_i, with which

    dm/dtheta = sum_i c_i dy_i/dtheta.

Extremes are those of the rows; where two are as large, the first one counts.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.derivatives.interpolation import LinearInterpolation
from phfmu.sweeps.measures import NUMBERS, mean, measures

Array = NDArray[np.float64]
Columns = Mapping[str, Array]

#: the times of rows among the weights of a measure
TIME = "time"


class RunMeasure(Protocol):
    """A number of a run: of the times (n) of its rows and of columns (n) of the signals it reads."""

    @property
    def signals(self) -> tuple[str, ...]: ...
    def value(self, t: Array, columns: Columns) -> float: ...
    def weights(self, t: Array, columns: Columns) -> dict[str, Array]:
        """Derivative of the number by each row (n) of each signal, and by the times of rows (`TIME`), which move at events."""
        ...


@dataclass(frozen=True)
class Expression:
    """Arithmetic on `signals`; `function` gives values and derivatives (n signals) at one row."""

    text: str
    signals: tuple[str, ...]
    function: ca.Function

    def over(self, columns: Columns) -> tuple[Array, Array]:
        """Values (rows) and derivatives (rows x signals)."""
        given = np.vstack([columns[n] for n in self.signals])
        value, slopes = self.function.map(given.shape[1])(given)
        return np.array(value).ravel(), np.array(slopes).reshape(len(self.signals), -1, order="F").T


#: functions of expressions
FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "sin": ca.sin, "cos": ca.cos, "tan": ca.tan, "exp": ca.exp, "log": ca.log, "sqrt": ca.sqrt, "abs": ca.fabs,
}  # fmt: skip
#: operators of expressions
OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}
_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*(?:\.\w+)*(?:\[\d+(?:,\d+)*\])?(?![\w.\[])(?!\s*\()")


def expression(text: str, signals: Sequence[str]) -> Expression:
    """The arithmetic of a text.  ValueError for what is none; KeyError for a signal that there is not."""
    from phfmu.words import meant

    found: dict[str, ca.SX] = {}

    def place(match: re.Match[str]) -> str:
        name = match[0]
        if name not in signals:
            raise KeyError(f"no signal '{name}' to measure; {meant(name, signals)}")
        found.setdefault(name, ca.SX.sym(name))
        return f"s{list(found).index(name)}"

    plain = _NAME.sub(place, text).replace("^", "**")
    try:
        tree = ast.parse(plain.strip(), mode="eval").body
        result = ca.SX(_value(tree, list(found.values())))
    except (SyntaxError, TypeError) as error:
        raise ValueError(
            f"measure {text}: expected arithmetic on signals with + - * / ^ and {', '.join(FUNCTIONS)}"
        ) from error
    if not found:
        raise ValueError(f"measure {text}: it names no signal")
    given = ca.vertcat(*found.values())
    function = ca.Function("measure", [given], [result, ca.densify(ca.gradient(result, given))])
    return Expression(text.strip(), tuple(found), function)


def _value(node: ast.AST, symbols: Sequence[ca.SX]) -> Any:
    match node:
        case ast.Constant(value=int() | float()):
            return float(node.value)  # pyright: ignore[reportArgumentType]
        case ast.Name(id=name):
            return symbols[int(name[1:])]
        case ast.UnaryOp(op=ast.USub(), operand=a):
            return -_value(a, symbols)
        case ast.BinOp(left=a, op=op, right=b) if type(op) in OPERATORS:
            return OPERATORS[type(op)](_value(a, symbols), _value(b, symbols))
        case ast.Call(func=ast.Name(id=name), args=[a], keywords=[]) if name in FUNCTIONS:
            return FUNCTIONS[name](_value(a, symbols))
    raise TypeError(ast.dump(node))


# -- rows to a number --------------------------------------------------------------------------------------------------


def _one(i: int, n: int, value: float = 1.0) -> Array:
    return value * np.eye(1, n, i % n)[0]


def _trapezoidal(t: Array) -> Array:
    """Weights of the integral over time by the trapezoidal rule."""
    half = np.diff(t) / 2.0
    return np.append(half, 0.0) + np.insert(half, 0, 0.0)


def _of_rms(t: Array, v: Array) -> Array:
    size = np.sqrt(mean(t, v * v))
    return _trapezoidal(t) * v / (size * (t[-1] - t[0])) if size else np.zeros_like(v)


def _peak(v: Array) -> int:
    return int(np.abs(v).argmax())


#: kind -> the number, of times and values
KINDS: dict[str, Callable[[Array, Array], float]] = NUMBERS | {"integral": lambda t, v: float(np.trapezoid(v, t))}


def _of_moved(t: Array, v: Array) -> Array:
    """Derivative of the integral by the time of each row; the first and the last one do not move."""
    found = np.zeros_like(v)
    found[1:-1] = (v[:-2] - v[2:]) / 2.0
    return found


def _of_moved_rms(t: Array, v: Array) -> Array:
    size = np.sqrt(mean(t, v * v))
    return _of_moved(t, v * v) / (2.0 * size * (t[-1] - t[0])) if size else np.zeros_like(v)


#: kind -> its derivative by the time of each row, of those that follow from it
BY_TIME: dict[str, Callable[[Array, Array], Array]] = {
    "mean": lambda t, v: _of_moved(t, v) / (t[-1] - t[0]),
    "rms": _of_moved_rms,
    "integral": _of_moved,
}
#: kind -> its derivative by each row, of those that have one
WEIGHTS: dict[str, Callable[[Array, Array], Array]] = {
    "first": lambda t, v: _one(0, len(v)),
    "last": lambda t, v: _one(-1, len(v)),
    "min": lambda t, v: _one(int(v.argmin()), len(v)),
    "max": lambda t, v: _one(int(v.argmax()), len(v)),
    "peak": lambda t, v: _one(_peak(v), len(v), float(np.sign(v[_peak(v)]))),
    "mean": lambda t, v: _trapezoidal(t) / (t[-1] - t[0]),
    "rms": _of_rms,
    "integral": lambda t, v: _trapezoidal(t),
}


@dataclass(frozen=True)
class Reduction:
    """`kind` of the rows of an expression."""

    kind: str
    of: Expression

    def __str__(self) -> str:
        return f"{self.kind}({self.of.text})"

    @property
    def signals(self) -> tuple[str, ...]:
        return self.of.signals

    def value(self, t: Array, columns: Columns) -> float:
        return KINDS[self.kind](t, self.of.over(columns)[0])

    def weights(self, t: Array, columns: Columns) -> dict[str, Array]:
        values, slopes = self.of.over(columns)
        own = WEIGHTS[self.kind](t, values)
        moved = {TIME: BY_TIME[self.kind](t, values)} if self.kind in BY_TIME else {}
        return moved | {n: own * slopes[:, i] for i, n in enumerate(self.of.signals)}


@dataclass(frozen=True)
class ValueAtTime:
    """An expression at a time (s), None the end of the run."""

    of: Expression
    t: float | None

    def __str__(self) -> str:
        return f"{self.of.text}@{'end' if self.t is None else f'{self.t:g}'}"

    @property
    def signals(self) -> tuple[str, ...]:
        return self.of.signals

    def value(self, t: Array, columns: Columns) -> float:
        values = self.of.over(columns)[0]
        return float(values[-1]) if self.t is None else float(LinearInterpolation(t, np.array([self.t])).of(values)[0])

    def weights(self, t: Array, columns: Columns) -> dict[str, Array]:
        values, slopes = self.of.over(columns)
        if self.t is None:
            own, moved = _one(-1, len(t)), {}
        else:
            between = LinearInterpolation(t, np.array([self.t]))
            own, moved = between.back(np.ones(1)), {TIME: between.back(-between.slopes(values))}
        return moved | {n: own * slopes[:, i] for i, n in enumerate(self.of.signals)}


@dataclass(frozen=True)
class SumOfSquares:
    """sum_j ((y(t_j) - data_j)/weight)^2 of a signal against data, on the line between rows; data that are NaN do not count."""

    signal: str
    times: ArrayLike
    data: ArrayLike
    weight: float = 1.0

    def __str__(self) -> str:
        return f"squares({self.signal})"

    @property
    def signals(self) -> tuple[str, ...]:
        return (self.signal,)

    def value(self, t: Array, columns: Columns) -> float:
        return float(np.sum(self._misfit(t, columns)[1] ** 2))

    def weights(self, t: Array, columns: Columns) -> dict[str, Array]:
        between, misfit = self._misfit(t, columns)
        bars = 2.0 * misfit / self.weight
        return {self.signal: between.back(bars), TIME: between.back(-bars * between.slopes(columns[self.signal]))}

    def _misfit(self, t: Array, columns: Columns) -> tuple[LinearInterpolation, Array]:
        there = np.isfinite(np.asarray(self.data, float))
        between = LinearInterpolation(t, np.asarray(self.times, float)[there])
        return between, (between.of(columns[self.signal]) - np.asarray(self.data, float)[there]) / self.weight


def run_measures(of: Sequence[str | RunMeasure], signals: Sequence[str]) -> list[RunMeasure]:
    """Measures by their texts (a pattern of signals gives one for each), and those that are given.

    Errors: ValueError for another form or kind; KeyError for signals that there are not.
    """
    found: list[RunMeasure] = []
    for item in of:
        found += _parsed(item, signals) if isinstance(item, str) else [item]
    return found


def _parsed(text: str, signals: Sequence[str]) -> list[RunMeasure]:
    at = re.fullmatch(r"(.+)@\s*(end|[-+.\deE]+)\s*", text)
    if at is not None:
        return [ValueAtTime(expression(at[1], signals), None if at[2] == "end" else float(at[2]))]
    form = re.fullmatch(r"\s*(\w+)\((.+)\)\s*", text)
    if form is not None and form[1] in WEIGHTS and (not set("*?") & set(form[2]) or _arithmetic(form[2], signals)):
        return [Reduction(form[1], expression(form[2], signals))]
    own = measures([text], signals)
    if times := [m for m in own if m.kind not in WEIGHTS]:
        raise ValueError(f"{times[0]} is the time of a row, which does not move; measures: {', '.join(WEIGHTS)}")
    return [Reduction(m.kind, expression(m.signal, signals)) for m in own]


def _arithmetic(text: str, signals: Sequence[str]) -> bool:
    """Whether a text with * is a product of signals rather than a pattern of them."""
    try:
        expression(text, signals)
    except (ValueError, KeyError):
        return False
    return True
