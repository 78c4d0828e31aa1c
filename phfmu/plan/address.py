"""Addresses: where the arguments and results of a kernel live in the spaces of a plan.

A place is a function (layout, term, j, node) -> index.  For an argument it is an index into Y = [unknowns | u | h | Z], for
a result one into Z (stage 0) or R (stage 1).  Here are the places that every scheme has; a technique writes those of its own
unknowns beside them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from phfmu.plan.unknown import ALGEBRAIC, COSTATE, INCREMENT
from phfmu.terms.term import Term

if TYPE_CHECKING:
    from phfmu.plan.layout import Layout

Place = Callable[["Layout", Term, int, int], int]


@dataclass(frozen=True, slots=True)
class Address:
    """The j-th local entry of a place, at a node."""

    place: Place
    j: int = 0
    node: int = 0

    def __call__(self, layout: Layout, term: Term) -> int:
        return self.place(layout, term, self.j, self.node)


# -- arguments ----------------------------------------------------------------------------------------------------------


def increment(layout: Layout, term: Term, j: int, node: int) -> int:
    """Increment of the term's j-th state."""
    return layout.at(INCREMENT, term.index["x"][j], node)


def own_costate(layout: Layout, term: Term, j: int, node: int) -> int:
    """Costate of the term's j-th state."""
    return layout.costate(term.index["x"][j], node)


def costate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The j-th costate that the term reads."""
    return layout.costate(term.index["z"][j], node)


def algebraic(layout: Layout, term: Term, j: int, node: int) -> int:
    """The j-th algebraic variable that the term reads."""
    return layout.at(ALGEBRAIC, term.index["a"][j], node)


def port_input(layout: Layout, term: Term, j: int, node: int) -> int:
    """The j-th port input that the term reads."""
    return layout.input_index(term.index["u"][j], node)


def step_size(layout: Layout, term: Term, j: int, node: int) -> int:
    """The step size h."""
    del term, j, node
    return layout.nv - 1


def force(layout: Layout, term: Term, j: int, node: int) -> int:
    """The multiplier of a constraint."""
    del j
    return layout.at(ALGEBRAIC, term.rows[0][1], node)


def _velocity(layout: Layout, term: Term, j: int) -> int:
    return layout.terms.velocity_of[term.index["x"][j]]


def velocity_increment(layout: Layout, term: Term, j: int, node: int) -> int:
    """Increment of the velocity that belongs to the term's j-th position; as a result: the balance of it."""
    return layout.at(INCREMENT, _velocity(layout, term, j), node)


def velocity_costate(layout: Layout, term: Term, j: int, node: int) -> int:
    """Costate of that velocity."""
    return layout.costate(_velocity(layout, term, j), node)


#: by the kind of value that a term reads
READ: dict[str, Place] = {"z": costate, "a": algebraic, "u": port_input}


# -- results ------------------------------------------------------------------------------------------------------------


def row(layout: Layout, term: Term, j: int, node: int) -> int:
    """The term's j-th row."""
    return layout.row(*term.rows[j], node)


def costate_row(layout: Layout, term: Term, j: int, node: int) -> int:
    """The row E^T z = grad H of the term's j-th state."""
    return layout.at(COSTATE, term.rows[j][1], node)


def gradient(layout: Layout, term: Term, j: int, node: int) -> int:
    """Slot of the costate (or gradient) of the term's j-th state."""
    return layout.slot(term.rows[j][1], node)


def velocity_gradient(layout: Layout, term: Term, j: int, node: int) -> int:
    """Slot of the costate of the velocity that belongs to the term's j-th position."""
    return layout.slot(_velocity(layout, term, j), node)


def velocity_costate_row(layout: Layout, term: Term, j: int, node: int) -> int:
    """The row of the costate of that velocity, where it is an unknown."""
    return layout.at(COSTATE, _velocity(layout, term, j), node)


def source(layout: Layout, term: Term, j: int, node: int) -> int:
    """Slot of a source."""
    del j
    return layout.source_slot(term.rows[0][1], node)


# -- old values ---------------------------------------------------------------------------------------------------------

#: x indices of the old values that a kernel of a term reads
Old = Callable[["Layout", Term], list[int]]


def states_then_time(layout: Layout, term: Term) -> list[int]:
    """The term's states, then time if it depends on it."""
    return [*term.index.get("x", ()), *_time(layout, term)]


def with_velocities(layout: Layout, term: Term) -> list[int]:
    """Positions, their velocities, then time."""
    positions = term.index["x"]
    return [*positions, *(layout.terms.velocity_of[q] for q in positions), *_time(layout, term)]


def with_algebraics(layout: Layout, term: Term) -> list[int]:
    """States, then the algebraic variables of the last step."""
    return [*term.index.get("x", ()), *(layout.terms.n1 + 1 + i for i in term.index["a"])]


def _time(layout: Layout, term: Term) -> list[int]:
    return [layout.terms.n1] if "t" in term.index else []
