"""Radau IIA with k stages: order 2k - 1, stiff decay is damped and the damping booked as numerical loss.

    sum_i b_i D_i^T grad H(X_i) = H(x') - H(x) + loss,     stored + dissipated + loss = supplied.

loss >= 0 for quadratic H (algebraic stability: K. Burrage, J. C. Butcher, SIAM J. Numer. Anal. 16, 1979).
"""

from __future__ import annotations

from dataclasses import dataclass

from phfmu.declare.error import DeclarationError
from phfmu.gradients.quadrature import Nodes, radau_nodes
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Holds
from phfmu.plan.planner import SchemeMaps
from phfmu.plan.spec import Spec
from phfmu.plan.unknown import Unknown
from phfmu.schemes.collocated import require_pairs
from phfmu.schemes.nodal import NodeKernels
from phfmu.schemes.scheme import GaussScheme, node_holds, node_maps, node_unknowns
from phfmu.terms.condense import condensed
from phfmu.terms.term import CLOSED, Term, Terms


@dataclass(frozen=True)
class Radau(GaussScheme):
    """k right Radau nodes, gradients at the nodes."""

    k: int = 2
    name: str = "radau"
    gradient = "nodal"
    loses_energy = True
    node_values = True

    @property
    def order(self) -> int:
        return 2 * self.k - 1

    @property
    def nodes(self) -> Nodes:
        return radau_nodes(self.k)

    def prepare(self, terms: Terms) -> Terms:
        """The terms; DeclarationError for closed-form pairs."""
        require_pairs(terms, 1)
        if terms.of(CLOSED):
            raise DeclarationError(
                terms.model.name,
                "the closed-form pair has no Radau form",
                "use flux coordinates, or --scheme collocated",
                "pair",
            )
        return condensed(terms)

    def unknowns(self, terms: Terms) -> list[Unknown]:
        return node_unknowns(terms, self.k)

    def specs(self, term: Term) -> list[Spec]:
        """Kernels of one term."""
        return NodeKernels(self.nodes, self.gradient, loses_energy=True).specs(term)

    def maps(self, layout: Layout) -> SchemeMaps:
        return node_maps(layout, self.nodes)

    def holds(self, layout: Layout) -> Holds:
        return node_holds(layout)
