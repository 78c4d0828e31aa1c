"""Holonomic models with positions and velocities on their constraints both: k Gauss nodes, k odd.

    q' = v + M^-1 S^T mu,   M v' = f - G^T lambda - K^T mu,   0 = G z_v + r,   0 = Dg(q') v' + g_t(q'),

the GGL form with discrete gradients; `constraints.py` has the rows, docs/proofs/constraints.md the proofs.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from phfmu.declare.error import DeclarationError
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Holds
from phfmu.plan.spec import Spec
from phfmu.plan.unknown import Unknown, of_algebraics
from phfmu.schemes.collocated import Collocated, require_gradient, require_pairs
from phfmu.schemes.constraints import constraints, impulses, inertia
from phfmu.schemes.constraints.constraints import VELOCITY_LEVEL
from phfmu.schemes.scheme import node_holds, node_unknowns
from phfmu.terms.condense import condensed
from phfmu.terms.term import CONSTRAINT, MASS, Term, Terms


@dataclass(frozen=True)
class TwoLevel(Collocated):
    """k = 1 or 3 Gauss nodes; gradients and all terms but the constraints and the masses they act on are as for `Collocated`."""

    name: str = "two-level"
    impulses: bool = field(default=True, init=False, repr=False)
    two_level = True

    def prepare(self, terms: Terms) -> Terms:
        """The terms with the masses of their constraints; DeclarationError names a remedy for terms that do not fit."""
        require_pairs(terms, self.k)
        require_gradient(self.gradient, self.k)
        if self.k % 2 == 0:
            raise DeclarationError("scheme two-level", "has odd stages only", "use --order 2 or 6", "stages")
        terms = inertia.prepare(terms)
        light = inertia.light(terms)
        if light and self.gradient not in ("per-term", "mean-value"):
            names = ", ".join(terms.state_names[i] for i in light[:6])
            raise DeclarationError(
                terms.model.name,
                f"{names} without mass have no {self.gradient} gradient",
                "use --gradient per-term",
                "mass",
            )
        return condensed(impulses.prepare(terms))

    def unknowns(self, terms: Terms) -> list[Unknown]:
        multipliers = [t.rows[0].index for t in terms.of(CONSTRAINT)]
        velocity = of_algebraics(terms, VELOCITY_LEVEL, "velocity constraint of", multipliers)
        costates = [*terms.solved_costates(), *inertia.light(terms)]
        return node_unknowns(terms, self.k, costates) + velocity + impulses.unknowns(terms)

    def specs(self, term: Term) -> list[Spec]:
        """Kernels of one term."""
        if term.kind is CONSTRAINT:
            return [impulses.shifted(s, term) for s in constraints.two_level(term, self.nodes)]
        if term.kind is MASS and inertia.is_light(term):
            return [impulses.shifted(s, term) for s in inertia.specs(term, self.nodes)]
        return super().specs(term)

    def holds(self, layout: Layout) -> Holds:
        return node_holds(layout, VELOCITY_LEVEL)
