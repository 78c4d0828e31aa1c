"""Unknowns of a discretised system, their kinds, and the words for them in errors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from phfmu.terms.term import Terms


@dataclass(frozen=True, eq=False)
class Role:
    """A kind of unknown; the technique that introduces it owns it.  `vanishes`: it does so with the step size."""

    name: str
    vanishes: bool = False


INCREMENT = Role("increment of a state", vanishes=True)
COSTATE = Role("costate of a state")
ALGEBRAIC = Role("algebraic variable")


@dataclass(frozen=True, slots=True)
class Unknown:
    """One unknown; its row has the same number.

    `index`: of the state or algebraic variable it belongs to;  `label`: its row, `variable`: what it stands for, both for
    messages;  `nominal`: its size.
    """

    role: Role
    index: int
    node: int
    label: str
    variable: str
    nominal: float


def of_states(terms: Terms, role: Role, label: str, states: Iterable[int], node: int = 0) -> list[Unknown]:
    """One unknown per state, of its size; `label` goes before its name."""
    names, size = terms.state_names, terms.state_nominals
    return [Unknown(role, i, node, f"{label} {names[i]}", names[i], size[i]) for i in states]


def of_algebraics(
    terms: Terms, role: Role, label: str, variables: Iterable[int], node: int = 0, nominal: float | None = None
) -> list[Unknown]:
    """One unknown per algebraic variable, of its size or of that given."""
    names, size = terms.algebraic_names, terms.algebraic_nominals
    return [
        Unknown(role, i, node, f"{label} {names[i]}", names[i], size[i] if nominal is None else nominal)
        for i in variables
    ]
