"""The discrete gradient pair scheme, k = 1.

With a discrete gradient pair (Ebar, zbar) of (H, E, z), that is zbar^T Ebar (x' - x) = H(x') - H(x), Ebar(x, x) = E(x),
zbar(x, x) = z(x), and matrices at the middle of the step,

    Ebar (x' - x) = h (J - R) zbar + h B u,      y = B^T zbar.

Semi-explicit models have the pair Ebar = diag(E11, 0), zbar = (E11^-T DG H1, z2bar) with z2bar by `closure`; then the
scheme is the semi-explicit one.  Models with a general E(x) bring theirs as a `ClosedPair`.
Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 223 (2026), (18), Theorems 2 and 4, Corollary 1.
"""

from __future__ import annotations

from dataclasses import dataclass

from phfmu.declare.error import DeclarationError
from phfmu.schemes.semi_explicit import ClosureScheme
from phfmu.terms.term import Terms


@dataclass(frozen=True)
class GradientPair(ClosureScheme):
    """One step with (Ebar, zbar), in the semi-explicit form with the same solution (Corollary 1).

    gradient: as for `Collocated(1)`;  closure: z2bar = x2' ("end") or (x2 + x2')/2 ("midpoint").  "start" is refused:
    with z2bar = x2 the new x2' would appear in no equation.
    """

    gradient: str = "per-term"
    closure: str = "midpoint"
    name: str = "gradient-pair"

    def prepare(self, terms: Terms) -> Terms:
        """The terms; DeclarationError for a closure that leaves x2' open."""
        if terms.na and self.closure == "start":
            names = ", ".join(terms.algebraic_names[:4])
            raise DeclarationError(
                terms.model.name,
                f"with zbar2 = x2 at the start of the step the new {names} would occur in no equation of a "
                "gradient pair",
                "use --closure midpoint or end",
                "closure",
            )
        return super().prepare(terms)
