"""Rates of values in differentiated rows: where kernels of the instant plan find them, and what is reported undifferentiated."""

from __future__ import annotations

from phfmu.declare.value import Value
from phfmu.plan.layout import Layout
from phfmu.plan.unknown import Role
from phfmu.terms.term import Term
from phfmu.terms.velocities import velocity_of

#: the rate of an algebraic variable that a differentiated row contains; its row is the undifferentiated one that gives it
RATE = Role("rate of an algebraic variable")


def algebraic_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the j-th algebraic variable that the term reads."""
    return layout.at(RATE, term.index[Value.ALGEBRAIC][j], node)


def input_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the algebraic variable that feeds the j-th input that the term reads."""
    return layout.at(RATE, layout.terms.bound[term.index[Value.INPUT][j]], node)


def costate_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the j-th costate that the term reads."""
    del node
    return layout.costate_rate(term.index[Value.COSTATE][j])


def velocity_costate_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """The rate of the costate of the velocity that belongs to the term's j-th position."""
    del node
    return layout.costate_rate(velocity_of(layout.terms)[term.index[Value.STATE][j]])


def gradient_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """Slot of the rate of the costate of the term's j-th state."""
    del node
    return layout.rate_slot(term.rows[j].index)


def source_rate(layout: Layout, term: Term, j: int, node: int) -> int:
    """Slot of the rate of a source."""
    del j, node
    return layout.source_rate_slot(term.rows[0].index)


def velocity_check(layout: Layout, term: Term, j: int, node: int) -> int:
    """The reported term's j-th row, undifferentiated."""
    del node
    return layout.report(("velocity", term.rows[j].index))


def position_check(layout: Layout, term: Term, j: int, node: int) -> int:
    """The reported constraint g."""
    del node
    return layout.report(("position", term.rows[j].index))
