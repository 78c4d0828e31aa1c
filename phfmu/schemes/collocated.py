"""Collocation at k Gauss nodes with discrete gradients: order 2k, exact power balance with R and ports.

Unknowns per node i: increments D_i = h x1'(t + c_i h) and algebraic values x2_i.  With X_i = x + sum_j a_ij D_j,

    E11(X_i) D_i = h [(J - R) Z_i + B u_i]_1,   0 = [(J - R) Z_i + B u_i]_2,   y_i = B^T Z_i,   x' = x + sum_i b_i D_i,

and E11^T Z_i = W_i, the node gradients of `gradients.py`.  k = 1 is the scheme (21) of Kinon, Morandin, Schulze
(Appl. Numer. Math. 2026), for holonomic models their (44).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

from phfmu.declare.error import DeclarationError
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Holds
from phfmu.plan.planner import SchemeMaps
from phfmu.plan.spec import Spec
from phfmu.plan.unknown import Unknown
from phfmu.schemes.constraints import impulses, inertia
from phfmu.schemes.nodal import NodeKernels
from phfmu.schemes.scheme import GaussScheme, node_holds, node_maps, node_unknowns
from phfmu.terms.bare import IMPULSE
from phfmu.terms.condense import condensed
from phfmu.terms.term import CLOSED, CONSTRAINT, Term, Terms


@dataclass(frozen=True)
class Collocated(GaussScheme):
    """k Gauss nodes.  The mean of x2 over the step is reported, nothing of it is carried on.

    gradient: "per-term" | "mean-value" | "joint-gonzalez", "itoh-abe", "itoh-abe-symmetric" (these k = 1).
    `impulses`: neutral impulse pairs at bare nodes, where their conditions hold (`impulses.py`).
    """

    k: int = 1
    gradient: str = "per-term"
    name: str = "collocated"
    impulses: bool = True
    node_values = True

    def prepare(self, terms: Terms) -> Terms:
        """The terms with their impulses; DeclarationError names a remedy for terms that do not fit."""
        require_pairs(terms, self.k)
        require_gradient(self.gradient, self.k)
        if self.k % 2 == 0 and terms.of(CONSTRAINT):
            raise DeclarationError(
                terms.model.name,
                f"order {2 * self.k} with holonomic constraints drifts off the velocity constraint",
                "use --order 2 or 6",
                "stages",
            )
        return condensed(impulses.prepare(terms) if self.impulses else terms)

    def unknowns(self, terms: Terms) -> list[Unknown]:
        return node_unknowns(terms, self.k) + impulses.unknowns(terms)

    def reports(self, terms: Terms) -> Sequence[Hashable]:
        return impulses.reports(terms)

    def specs(self, term: Term) -> list[Spec]:
        """Kernels of one term."""
        if term.kind is IMPULSE:
            return impulses.specs(term, self.nodes)
        return [impulses.shifted(s, term) for s in NodeKernels(self.nodes, self.gradient).specs(term)]

    def maps(self, layout: Layout) -> SchemeMaps:
        even = self.k > 1 and inertia.uneven(layout.terms)
        return impulses.maps(layout, node_maps(layout, self.nodes, even=even))

    def holds(self, layout: Layout) -> Holds:
        return node_holds(layout)


def require_pairs(terms: Terms, k: int) -> None:
    """Raise DeclarationError for closed-form pairs without a discrete pair, or with k > 1."""
    for pair in terms.model.closed:
        if pair.ebar is None or pair.zbar is None:
            names = ", ".join(v.name for v in pair.variables)
            raise DeclarationError(
                terms.model.name, f"the pair (E, z) on {names} has no discrete pair",
                "give ebar and zbar, or use --scheme dirac-dissipative", "pair",
            )  # fmt: skip
    if k > 1 and terms.of(CLOSED):
        raise DeclarationError(
            terms.model.name,
            "the closed-form pair has order 2 only",
            f"use --order 2, or flux coordinates for order {2 * k}",
            "order",
        )


def require_gradient(gradient: str, k: int) -> None:
    """Raise DeclarationError for a gradient that has one node only."""
    if k > 1 and gradient not in ("per-term", "mean-value"):
        raise DeclarationError(
            f"gradient {gradient}", "has order 2 at most", "use --gradient per-term for a higher order", "order"
        )
