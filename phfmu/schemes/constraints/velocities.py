"""The velocities that belong to positions, on which forces of holonomic constraints act."""

from __future__ import annotations

from phfmu.declare.variable import ValueKind
from phfmu.plan.address import time
from phfmu.plan.layout import Layout
from phfmu.plan.unknown import ALGEBRAIC, COSTATE, INCREMENT
from phfmu.terms.term import Term
from phfmu.terms.velocities import velocity_of


def _velocity(layout: Layout, term: Term, j: int) -> int:
    return velocity_of(layout.terms)[term.index[ValueKind.STATE][j]]


def force(layout: Layout, term: Term, j: int, node: int) -> int:
    """The multiplier of a constraint."""
    del j
    return layout.at(ALGEBRAIC, term.rows[0].index, node)


def velocity_increment(layout: Layout, term: Term, j: int, node: int) -> int:
    """Increment of the velocity that belongs to the term's j-th position; as a result: the balance of it."""
    return layout.at(INCREMENT, _velocity(layout, term, j), node)


def velocity_costate(layout: Layout, term: Term, j: int, node: int) -> int:
    """Costate of that velocity."""
    return layout.costate(_velocity(layout, term, j), node)


def velocity_gradient(layout: Layout, term: Term, j: int, node: int) -> int:
    """Slot of the costate of that velocity."""
    return layout.slot(_velocity(layout, term, j), node)


def velocity_costate_row(layout: Layout, term: Term, j: int, node: int) -> int:
    """The row of the costate of that velocity, where it is an unknown."""
    return layout.at(COSTATE, _velocity(layout, term, j), node)


def with_velocities(layout: Layout, term: Term) -> list[int]:
    """Old values: positions, their velocities, then time."""
    positions, velocity = term.index[ValueKind.STATE], velocity_of(layout.terms)
    return [*positions, *(velocity[q] for q in positions), *time(layout, term)]
