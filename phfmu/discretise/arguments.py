"""Local arguments of a term, created on demand."""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca

from phfmu.discretise.spec import Address
from phfmu.discretise.terms import Term

EMPTY = ca.SX(0, 1)


@dataclass
class Arguments:
    """Symbols of a term's arguments at k nodes, in a fixed order, with their addresses."""

    term: Term
    k: int
    y: list[tuple[Address, ca.SX]] = field(default_factory=list)

    def symbol(self, kind: str, j: int, i: int) -> ca.SX:
        """The argument (kind, j, i) as a fresh scalar symbol."""
        s = ca.SX.sym(f"{kind}{j}_{i}")
        self.y.append(((kind, j, i), s))
        return s

    def matrix(self, kind: str, n: int) -> ca.SX:
        """n x k symbols of one kind, node by node."""
        return ca.horzcat(*(ca.vertcat(*(self.symbol(kind, j, i) for j in range(n))) for i in range(self.k)))

    @property
    def x(self) -> ca.SX:
        """Old states of the term, then time if it depends on it."""
        return ca.vertcat(self.term.local.get("x", EMPTY), self.term.local.get("t", EMPTY))

    @property
    def p(self) -> ca.SX:
        return self.term.local.get("p", EMPTY)
