"""The discrete gradient pair scheme, k = 1.

With a discrete gradient pair (Ebar, zbar) of (H, E, z), that is zbar^T Ebar (x' - x) = H(x') - H(x), Ebar(x, x) = E(x),
zbar(x, x) = z(x), and matrices at the middle of the step,

    Ebar (x' - x) = h (J - R) zbar + h B u,      y = B^T zbar.

Semi-explicit models have the pair Ebar = diag(E11, 0), zbar = (E11^-T DG H1, z2bar) with z2bar by `closure`; then the
scheme is the semi-explicit one.  Models with a general E(x) bring theirs as a `ClosedPair`.
Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 223 (2026), (18), Theorems 2 and 4, Corollary 1.
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
from phfmu.schemes.scheme import Triplet
from phfmu.schemes.semi_explicit import SemiExplicit
from phfmu.terms.term import DeclarationError, Term, Terms


@dataclass(frozen=True)
class GradientPair:
    """One step with (Ebar, zbar).

    gradient: as for `Collocated(1)`;  closure: z2bar = x2' ("end") or (x2 + x2')/2 ("midpoint").  "start" is refused:
    with z2bar = x2 the new x2' would appear in no equation.
    """

    gradient: str = "per-term"
    closure: str = "midpoint"
    name: str = "gradient-pair"

    two_level: bool = field(default=False, init=False, repr=False)
    impulses: bool = field(default=False, init=False, repr=False)
    loses_energy: bool = field(default=False, init=False, repr=False)

    @property
    def _form(self) -> SemiExplicit:
        """The semi-explicit form with the same solution (Corollary 1)."""
        return SemiExplicit(self.closure, self.gradient, self.name)

    @property
    def joint(self) -> bool:
        return self._form.joint

    @property
    def order(self) -> int:
        return self._form.order

    @property
    def nodes(self) -> Nodes:
        return self._form.nodes

    def prepare(self, terms: Terms) -> Terms:
        """The terms; DeclarationError for a closure that leaves x2' open."""
        if terms.na and self.closure == "start":
            names = ", ".join(terms.algebraic_names[:4])
            raise DeclarationError(
                f"{terms.model.name}: with zbar2 = x2 at the start of the step the new {names} would occur "
                "in no equation of a gradient pair; use --closure midpoint or end"
            )
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
