"""Places of the values and rows of a declaration, and the constant entries between them.

With E x' = (J - R) z + B u the rows are the balances of the states, the algebraic equations and the outputs y = B^T z of the
scalar port pairs; a declaration also has rows of observables and of sources.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from phfmu.declare.variable import ValueKind


class Row(Enum):
    """A kind of row."""

    BALANCE = "balance of a state"
    EQUATION = "algebraic equation"
    OUTPUT = "output of a port pair"
    OBSERVABLE = "observable"
    SOURCE = "source of a port pair"
    CONDENSED = "value of a condensed variable"

    __hash__ = object.__hash__  # its members are keys of many tables


class ValueAt(NamedTuple):
    """The value number `index` of its kind."""

    kind: ValueKind
    index: int


class RowAt(NamedTuple):
    """The row number `index` of its kind."""

    kind: Row
    index: int


class Constant(NamedTuple):
    """A constant entry: `row` contains `value` times `source`."""

    row: RowAt
    source: ValueAt
    value: float


#: the row that belongs to a variable of J, R or B, and the effort that its column multiplies
ROW_OF = {ValueKind.STATE: Row.BALANCE, ValueKind.ALGEBRAIC: Row.EQUATION, ValueKind.INPUT: Row.OUTPUT}
EFFORT_OF = {Row.BALANCE: ValueKind.COSTATE, Row.EQUATION: ValueKind.ALGEBRAIC, Row.OUTPUT: ValueKind.INPUT}
