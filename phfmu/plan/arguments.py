"""Local arguments of a term, created on demand."""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca

from phfmu.declare.value import Value
from phfmu.plan.address import Address, Place
from phfmu.terms.term import Term


@dataclass
class Arguments:
    """Symbols of a term's arguments at k nodes, in a fixed order, with their addresses."""

    term: Term
    k: int
    y: list[tuple[Address, ca.SX]] = field(default_factory=list)

    def symbol(self, place: Place, j: int = 0, node: int = 0) -> ca.SX:
        """An argument as a fresh scalar symbol."""
        s = ca.SX.sym("y")  # kernels that differ in names only are one
        self.y.append((Address(place, j, node), s))
        return s

    def matrix(self, place: Place, n: int) -> ca.SX:
        """n x k symbols of one place, node by node."""
        return ca.horzcat(*(ca.vertcat(*(self.symbol(place, j, i) for j in range(n))) for i in range(self.k)))

    @property
    def x(self) -> ca.SX:
        """Old states of the term, then time if it depends on it."""
        return ca.vertcat(self.term.symbols(Value.STATE), self.term.symbols(Value.TIME))

    @property
    def p(self) -> ca.SX:
        return self.term.symbols(Value.PARAMETER)
