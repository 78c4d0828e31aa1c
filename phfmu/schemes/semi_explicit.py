"""The semi-explicit scheme with a closure (k = 1): the algebraic state x2 is carried from step to step.

The equations are those of `Collocated(1)`; f2 = z2bar(x2, x2') of `closure.py` ties x2 to its costate.
Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 223 (2026), Theorem 4, Proposition 1.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

from phfmu.gradients.quadrature import Nodes, nodes
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Holds
from phfmu.plan.planner import Maps
from phfmu.plan.spec import Spec
from phfmu.plan.unknown import Unknown
from phfmu.schemes import closure
from phfmu.schemes.collocated import require_pairs
from phfmu.schemes.nodal import NodeKernels
from phfmu.schemes.scheme import Triplet, node_constants, node_unknowns
from phfmu.terms.term import Term, Terms


@dataclass(frozen=True)
class SemiExplicit:
    """closure: where x2 of a step belongs, "end" | "start" | "midpoint";  gradient: as for `Collocated(1)`."""

    closure: str = "midpoint"
    gradient: str = "per-term"
    name: str = "semi-explicit"
    two_level: bool = field(default=False, init=False, repr=False)
    impulses: bool = field(default=False, init=False, repr=False)
    loses_energy: bool = field(default=False, init=False, repr=False)

    @property
    def joint(self) -> bool:
        return self.gradient == "joint-gonzalez"

    @property
    def order(self) -> int:
        return 1 if self.gradient == "itoh-abe" else 2

    @property
    def nodes(self) -> Nodes:
        return nodes(1)

    def prepare(self, terms: Terms) -> Terms:
        """The terms with their closures; DeclarationError says what does not fit."""
        require_pairs(terms, 1)
        closure.require(self.closure, self.name)
        return closure.add(terms)

    def unknowns(self, terms: Terms) -> list[Unknown]:
        return node_unknowns(terms, 1) + closure.unknowns(terms)

    def reports(self, terms: Terms) -> Sequence[Hashable]:
        del terms
        return ()

    def specs(self, term: Term) -> list[Spec]:
        """Kernels of one term."""
        if term.kind is closure.CLOSURE:
            return closure.specs(term, self.closure)
        return NodeKernels(self.nodes, self.gradient).specs(term)

    def constants(self, layout: Layout) -> list[Triplet]:
        return node_constants(layout)

    def maps(self, layout: Layout) -> Maps:
        return closure.maps(layout)

    def holds(self, layout: Layout) -> Holds:
        del layout
        return Holds()
