"""Variables of a declaration: states, algebraic variables and parameters, scalar or vector.

The symbols of a declaration stand for values of them, and each variable is of one kind.
"""

from __future__ import annotations

import operator
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, StrEnum
from typing import Any, Protocol

import casadi as ca
import numpy as np

from phfmu.declare.elements import element_names, labelled
from phfmu.declare.error import DeclarationError


class ValueKind(Enum):
    """A kind of value that expressions of a declaration are made of."""

    STATE = "x"
    COSTATE = "z"
    ALGEBRAIC = "a"
    INPUT = "u"  # of a scalar port pair
    PARAMETER = "p"
    TIME = "t"
    INCREMENT = "d"  # of a state over a step: closed-form pairs are given with it
    INVARIANT = "c"  # C of a strain energy phi(C)

    __hash__ = object.__hash__  # its members are keys of many tables


class VariableKind(StrEnum):
    """By its part in E(x) x' = (J - R) z + B u: in x1, in x2, or held constant."""

    STATE = "state"
    ALGEBRAIC = "algebraic"
    PARAMETER = "parameter"


# NumPy's functions of an expression are expressions, as the notice says of symbols; it concerns arrays of numbers.
warnings.filterwarnings("ignore", r"\s*casadi: a numpy function was called", FutureWarning)

Number = float | Sequence[float] | np.ndarray

#: The one symbol for time; sources and observables may depend on it.
time: ca.SX = ca.SX.sym("time")


def _values(name: str, what: str, value: Number, size: int) -> tuple[float, ...]:
    if isinstance(value, float):
        return (float(value),) * size
    try:
        array = np.atleast_1d(np.asarray(value, dtype=float)).ravel() if value is not None else None
    except (TypeError, ValueError):
        array = None
    if array is None:
        raise DeclarationError(
            name, f"{what} = {value!r}", f"give a number, or one for each of the {size} entries", "start"
        )
    if array.size == 1:
        array = np.full(size, array[0])
    if array.size != size:
        raise DeclarationError(
            name,
            f"{what} has {array.size} entries, the variable has {size}",
            "give one number, or one for each entry",
            "shape",
        )
    return tuple(float(v) for v in array)


class _Arithmetic:
    """Lets a Variable stand for its symbol in expressions."""

    sx: ca.SX

    def __SX__(self) -> ca.SX:  # noqa: N807  (CasADi's conversion hook)
        return self.sx

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """NumPy's functions of a variable are CasADi's of its symbols, so that np.cos(v) is an expression."""
        name = function.__name__
        made = getattr(operator, _OPERATORS.get(name, ""), None) or getattr(ca, _FUNCTIONS.get(name, name), None)
        try:
            if made is not None and method == "__call__" and not options:
                return made(
                    *(ca.DM(np.asarray(i, float)) if isinstance(i, np.ndarray | np.generic) else _sx(i) for i in inputs)
                )
        except (NotImplementedError, TypeError):
            pass
        raise DeclarationError(
            f"numpy.{name}", f"does not know symbols such as {self.sx}", "write a function of CasADi"
        )

    def __float__(self) -> float:
        name = getattr(self, "name", "it")
        raise DeclarationError(
            f"'{name}'",
            "is a symbol, not a number",
            f"write functions of CasADi, e.g. casadi.cos({name}.sx), not of math",
        )

    def __abs__(self) -> ca.SX:
        return ca.fabs(self.sx)

    def __lt__(self, other: Any) -> ca.SX:
        """No order between symbols: `if flux > 0` and `max(flux, 0)` would have to be decided now."""
        name = getattr(self, "name", "it")
        remedy = f"write casadi.if_else({name}.sx > .., a, b), casadi.fmax or casadi.fmin"
        raise DeclarationError(f"'{name}'", "is a symbol, which is larger or smaller only in a run", remedy)

    __gt__ = __le__ = __ge__ = __lt__

    def __getitem__(self, index: Any) -> ca.SX:
        return self.sx[index]

    def __neg__(self) -> ca.SX:
        return -self.sx

    def __add__(self, other: Any) -> ca.SX:
        return self.sx + _sx(other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> ca.SX:
        return self.sx - _sx(other)

    def __rsub__(self, other: Any) -> ca.SX:
        return _sx(other) - self.sx

    def __mul__(self, other: Any) -> ca.SX:
        return self.sx * _sx(other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> ca.SX:
        return self.sx / _sx(other)

    def __rtruediv__(self, other: Any) -> ca.SX:
        return _sx(other) / self.sx

    def __pow__(self, other: Any) -> ca.SX:
        return self.sx ** _sx(other)

    def __matmul__(self, other: Any) -> ca.SX:
        return ca.mtimes(self.sx, _sx(other))


#: NumPy's names of operators
_OPERATORS = {"add": "add", "subtract": "sub", "multiply": "mul", "divide": "truediv", "power": "pow", "matmul": "matmul",
              "negative": "neg", "absolute": "abs"}  # fmt: skip
_FUNCTIONS = {"minimum": "fmin", "maximum": "fmax"}


def _sx(value: Any) -> Any:
    return value.sx if isinstance(value, _Arithmetic) else value


@dataclass(frozen=True, eq=False)
class Variable(_Arithmetic):
    """A named symbol (n x 1) with unit, start and nominal values.

    `z` is the symbol of its effort (costate) z; for algebraic variables z is the variable itself.
    Identity is object identity: two calls give two different variables.  A view made by `part` shares the symbols;
    `offset` is where it begins.
    """

    name: str
    kind: VariableKind
    size: int | None
    unit: str
    start: tuple[float, ...]
    nominal: tuple[float, ...]
    description: str
    sx: ca.SX = field(repr=False)
    z: ca.SX = field(repr=False)
    offset: int = 0
    #: limits of a parameter, both allowed themselves; None: see `parameter_limits.py`
    min: tuple[float, ...] | None = None
    max: tuple[float, ...] | None = None
    #: the value 0 is not allowed either
    positive: bool = False
    #: of a parameter: others feed it, see `signal.py`
    signal: bool = False
    #: what the entries of a vector are called in pictures, see `elements.py`; (): they have no names
    elements: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of scalar entries."""
        return self.size or 1

    def names(self) -> list[str]:
        """Scalar names, `[1]`-based for vectors."""
        return [self.name] if self.size is None else [f"{self.name}[{self.offset + i + 1}]" for i in range(self.size)]

    def labels(self) -> list[str]:
        """The names, with the elements by theirs: `psi[d]`."""
        return labelled(self.names(), self.elements)

    def part(self, first: int, n: int) -> Variable:
        """Entries first .. first + n - 1 (from 0) as a view, for blocks and ports that act on few entries.

        DeclarationError if the variable has no such entries.
        """
        if first < 0 or n < 1 or first + n > self.n:
            reason = f"has {self.n} entries, not {first + 1} .. {first + n}"
            raise DeclarationError(self.name, reason, "take a part within them", "shape")
        rows = slice(first, first + n)
        return replace(
            self, size=n, start=self.start[rows], nominal=self.nominal[rows], sx=self.sx[rows], z=self.z[rows],
            offset=self.offset + first, min=self.min and self.min[rows], max=self.max and self.max[rows],
            elements=self.elements[rows],
        )  # fmt: skip


class HasSymbols(Protocol):
    """A variable, or a port by its inputs."""

    @property
    def sx(self) -> ca.SX: ...
    @property
    def n(self) -> int: ...


def key(v: HasSymbols) -> int:
    """The identity of a variable (or port): its symbols."""
    return v.sx[0].element_hash()


def slices(variables: Sequence[Variable]) -> dict[int, slice]:
    """The slice of each variable, by its key, in the stack of all."""
    out, at = {}, 0
    for v in variables:
        out[key(v)] = slice(at, at + v.n)
        at += v.n
    return out


def make_variable(
    kind: VariableKind, name: str, size: int | None, unit: str, start: Number, nominal: Number, description: str,
    elements: Sequence[str] = (),
) -> Variable:  # fmt: skip
    """Build a variable with fresh symbols; `size=None` is a scalar."""
    called = element_names(f"'{name}'", elements, size)
    n = 1 if size is None else size
    sx = ca.SX.sym(name, n)
    z = sx if kind is not VariableKind.STATE else ca.SX.sym("z." + name, n)
    starts = _values(name, "start", start, n)
    nominals = _values(name, "nominal", nominal, n)
    return Variable(name, kind, size, unit, starts, nominals, description, sx, z, elements=called)


def state(
    name: str,
    size: int | None = None,
    *,
    unit: str = "1",
    start: Number = 0.0,
    nominal: Number = 1.0,
    description: str = "",
    elements: Sequence[str] = (),
) -> Variable:
    """A differential variable, part of x1.

    size:     number of entries of a vector, called name[1], name[2], ..; None: a scalar, called name
    elements: what the entries are called in pictures, e.g. ("d", "q", "0") for name[d], name[q], name[0]
    unit:     of all entries;  start, nominal: one number, or one for each entry
    nominal:  typical magnitude, scales the stopping test
    """
    return make_variable(VariableKind.STATE, name, size, unit, start, nominal, description, elements)


def algebraic(
    name: str,
    size: int | None = None,
    *,
    unit: str = "1",
    start: Number = 0.0,
    nominal: Number = 1.0,
    description: str = "",
    elements: Sequence[str] = (),
) -> Variable:
    """An algebraic variable, part of x2 = z2 (multiplier, node voltage, source current); arguments as for `state`."""
    return make_variable(VariableKind.ALGEBRAIC, name, size, unit, start, nominal, description, elements)


def parameter(
    name: str,
    value: Number,
    size: int | None = None,
    *,
    unit: str = "1",
    min: Number | None = None,
    max: Number | None = None,
    positive: bool = False,
    description: str = "",
    elements: Sequence[str] = (),
) -> Variable:
    """A constant that may be changed before (and by events during) a run.

    `value`: one number, or one for each entry;  `size`, `elements`: as for `state`.
    `min`, `max`: limits, allowed themselves;  `positive`: above 0.  Without `min` it is derived where the declaration
    proves it (a resistance, a mass: see `phfmu.declare.entries.parameter_limits`); `min=-inf` says that there is none.
    """
    made = make_variable(VariableKind.PARAMETER, name, size, unit, value, 1.0, description, elements)
    limits = {what: _values(name, what, v, made.n) for what, v in (("min", min), ("max", max)) if v is not None}
    return replace(made, **limits, positive=positive) if limits or positive else made
