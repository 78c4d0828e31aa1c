"""Addresses: where the arguments and results of a kernel live in the spaces of a plan.

A place is a function (layout, term, j, node) -> index.  For an argument it is an index into Y = [unknowns | u | h | Z], for
a result one into Z (stage 0) or R (stage 1).  Here are the places that every scheme has; a technique writes those of its own
unknowns beside them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from phfmu.declare.variable import ValueKind
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
    return layout.at(INCREMENT, term.index[ValueKind.STATE][j], node)


def own_costate(layout: Layout, term: Term, j: int, node: int) -> int:
    """Costate of the term's j-th state."""
    return layout.costate(term.index[ValueKind.STATE][j], node)


def costate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The j-th costate that the term reads."""
    return layout.costate(term.index[ValueKind.COSTATE][j], node)


def algebraic(layout: Layout, term: Term, j: int, node: int) -> int:
    """The j-th algebraic variable that the term reads."""
    return layout.at(ALGEBRAIC, term.index[ValueKind.ALGEBRAIC][j], node)


def port_input(layout: Layout, term: Term, j: int, node: int) -> int:
    """The j-th port input that the term reads."""
    return layout.input_index(term.index[ValueKind.INPUT][j], node)


def step_size(layout: Layout, term: Term, j: int, node: int) -> int:
    """The step size h."""
    del term, j, node
    return layout.nv - 1


#: places by the kind of value that a term reads
READ: dict[ValueKind, Place] = {ValueKind.COSTATE: costate, ValueKind.ALGEBRAIC: algebraic, ValueKind.INPUT: port_input}


# -- results ------------------------------------------------------------------------------------------------------------


def row(layout: Layout, term: Term, j: int, node: int) -> int:
    """The term's j-th row."""
    return layout.row(term.rows[j], node)


def costate_row(layout: Layout, term: Term, j: int, node: int) -> int:
    """The row E^T z = grad H of the term's j-th state."""
    return layout.at(COSTATE, term.rows[j].index, node)


def gradient(layout: Layout, term: Term, j: int, node: int) -> int:
    """Slot of the costate (or gradient) of the term's j-th state."""
    return layout.slot(term.rows[j].index, node)


def source(layout: Layout, term: Term, j: int, node: int) -> int:
    """Slot of a source."""
    del j
    return layout.source_slot(term.rows[0].index, node)


# -- old values ---------------------------------------------------------------------------------------------------------

#: x indices of the old values that a kernel of a term reads
Old = Callable[["Layout", Term], list[int]]


def states_then_time(layout: Layout, term: Term) -> list[int]:
    """The term's states, then time if it depends on it."""
    return [*term.indices(ValueKind.STATE), *time(layout, term)]


def with_algebraics(layout: Layout, term: Term) -> list[int]:
    """States, then the algebraic variables of the last step."""
    return [*term.indices(ValueKind.STATE), *(layout.terms.n1 + 1 + i for i in term.index[ValueKind.ALGEBRAIC])]


def time(layout: Layout, term: Term) -> list[int]:
    """Time, if the term depends on it."""
    return [layout.terms.n1] if ValueKind.TIME in term.index else []
