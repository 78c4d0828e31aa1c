"""What the symbols of a declaration stand for."""

from __future__ import annotations

from enum import Enum


class Value(Enum):
    """A kind of value that expressions of a declaration are made of."""

    STATE = "x"
    COSTATE = "z"
    ALGEBRAIC = "a"
    INPUT = "u"  # of a scalar port pair
    PARAMETER = "p"
    TIME = "t"
    INCREMENT = "d"  # of a state over a step: closed-form pairs are given with it
    INVARIANT = "c"  # C of a strain energy phi(C)
