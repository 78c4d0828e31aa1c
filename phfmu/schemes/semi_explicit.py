"""The semi-explicit scheme with a closure (k = 1): the algebraic state x2 is carried from step to step.

The equations are those of `Collocated(1)`; f2 = z2bar(x2, x2') of `closure.py` ties x2 to its costate.
Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 223 (2026), Theorem 4, Proposition 1.
"""

from __future__ import annotations

from dataclasses import dataclass

from phfmu.plan.layout import Layout
from phfmu.plan.planner import SchemeMaps
from phfmu.plan.spec import Spec
from phfmu.plan.unknown import Unknown
from phfmu.schemes import closure
from phfmu.schemes.collocated import require_pairs
from phfmu.schemes.nodal import NodeKernels
from phfmu.schemes.scheme import GaussScheme, node_unknowns
from phfmu.terms.term import Term, Terms


class ClosureScheme(GaussScheme):
    """Base of the schemes with a closure; `closure`, `gradient` and `name` belong to the scheme that has them."""

    closure: str
    name: str

    def prepare(self, terms: Terms) -> Terms:
        """The terms with their closures; DeclarationError names a remedy for terms that do not fit."""
        require_pairs(terms, 1)
        closure.require(self.closure, self.name)
        return closure.add(terms)

    def unknowns(self, terms: Terms) -> list[Unknown]:
        return node_unknowns(terms, 1) + closure.unknowns(terms)

    def specs(self, term: Term) -> list[Spec]:
        """Kernels of one term."""
        if term.kind is closure.CLOSURE:
            return closure.specs(term, self.closure)
        return NodeKernels(self.nodes, self.gradient).specs(term)

    def maps(self, layout: Layout) -> SchemeMaps:
        return closure.maps(layout)


@dataclass(frozen=True)
class SemiExplicit(ClosureScheme):
    """closure: where x2 of a step belongs, "end" | "start" | "midpoint";  gradient: as for `Collocated(1)`."""

    closure: str = "midpoint"
    gradient: str = "per-term"
    name: str = "semi-explicit"
