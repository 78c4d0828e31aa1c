"""The midpoint rule MP, the baseline without energy exactness: gradients at the midpoint, whatever H is.

E11 (x' - x) = h [(J - R) grad H((x + x')/2) + B u]_1,   0 = [..]_2
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

from phfmu.gradients.quadrature import Nodes
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Holds
from phfmu.plan.planner import Maps
from phfmu.plan.spec import Spec
from phfmu.plan.unknown import Unknown
from phfmu.schemes.collocated import Collocated
from phfmu.schemes.scheme import Triplet
from phfmu.terms.term import Term, Terms


@dataclass(frozen=True)
class Midpoint:
    """Collocation with one node and the gradient there; the residual of the balance is what that misses."""

    name: str = "midpoint"
    gradient: str = field(default="nodal", init=False, repr=False)
    joint: bool = field(default=False, init=False, repr=False)
    two_level: bool = field(default=False, init=False, repr=False)
    impulses: bool = field(default=True, init=False, repr=False)
    loses_energy: bool = field(default=False, init=False, repr=False)

    @property
    def _form(self) -> Collocated:
        return Collocated(1, self.gradient, self.name)

    @property
    def order(self) -> int:
        return 2

    @property
    def nodes(self) -> Nodes:
        return self._form.nodes

    def prepare(self, terms: Terms) -> Terms:
        return self._form.prepare(terms)

    def unknowns(self, terms: Terms) -> list[Unknown]:
        return self._form.unknowns(terms)

    def reports(self, terms: Terms) -> Sequence[Hashable]:
        return self._form.reports(terms)

    def specs(self, term: Term) -> list[Spec]:
        return self._form.specs(term)

    def constants(self, layout: Layout) -> list[Triplet]:
        return self._form.constants(layout)

    def maps(self, layout: Layout) -> Maps:
        return self._form.maps(layout)

    def holds(self, layout: Layout) -> Holds:
        return self._form.holds(layout)
