"""What a variable of a declaration is."""

from __future__ import annotations

from enum import StrEnum


class VariableKind(StrEnum):
    """By its part in E(x) x' = (J - R) z + B u: in x1, in x2, or held constant."""

    STATE = "state"
    ALGEBRAIC = "algebraic"
    PARAMETER = "parameter"
