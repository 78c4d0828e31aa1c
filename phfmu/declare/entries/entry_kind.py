"""Kinds of expressions in a declaration."""

from __future__ import annotations

from enum import StrEnum


class EntryKind(StrEnum):
    """By the letters of E(x) x' = (J - R) z + B u; words for what the equation has no letter for."""

    H = "H"
    E = "E"
    J = "J"
    R = "R"
    B = "B"
    COSTATE = "z"
    EFFORT = "z2"  # the given effort of an algebraic variable
    INVARIANT = "C"
    CONSTRAINT = "g"
    SOURCE = "source"
    OBSERVABLE = "observable"
    GUARD = "guard"
    BOUND = "bound"  # the algebraic variable that feeds a port
    COLUMN = "L"  # of a jump
    RESTITUTION = "e"  # of a jump
    CLOSED = "closed"  # a closed-form pair
    CORRECT = "correct"  # states that take the correction of an energy
