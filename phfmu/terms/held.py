"""Hidden constraints of the velocity level as impulses meet them: c = A^T z + c0, whose impulse s moves x+ = x- + E^-1 A s.

J is skew, so what a constraint reads is what its multiplier acts on.  Where several rows share a variable (the common velocity
of a rigid joint) it is eliminated, and A s is what their impulses do together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from phfmu.terms.hidden import Check, HiddenConstraints, Level
from phfmu.terms.port_impulses import mass_values, masses
from phfmu.terms.rows import block_matrix, check_rows, costate_symbols
from phfmu.terms.term import MASS, MASS_BLOCK, Terms
from phfmu.terms.velocities import velocity_of


@dataclass(frozen=True, eq=False)
class HeldConstraints:
    """n constraints: their `names`; A (n1 x n) and c0 (n), what moves a constraint besides the states, in x, p, and time."""

    names: tuple[str, ...]
    A: ca.SX
    c0: ca.SX

    def chosen(self, which: Sequence[int]) -> HeldConstraints:
        """The constraints at the places `which`."""
        at = list(which)
        return HeldConstraints(tuple(self.names[i] for i in at), self.A[:, at], self.c0[at])


def velocity_checks(terms: Terms) -> list[Check]:
    """The hidden constraints of the velocity level, in the order of a model's checks."""
    return [Check(terms.algebraic_names[row], Level.VELOCITY, row) for row in terms.found(HiddenConstraints).checks]


def held(terms: Terms) -> HeldConstraints:
    """All of them."""
    checks = velocity_checks(terms)
    if not checks:
        return HeldConstraints((), ca.SX(terms.n1, 0), ca.SX(0, 1))
    z = costate_symbols(terms.model)
    c = ca.vertcat(*check_rows(terms, checks, z))
    A = ca.sparsify(ca.simplify(ca.jacobian(c, z)))
    return HeldConstraints(tuple(k.name for k in checks), A.T, ca.substitute(c, z, ca.SX(ca.DM.zeros(*z.shape))))


def rates(terms: Terms, A: ca.SX) -> ca.SX:
    """E^-1 A."""
    out = A / ca.repmat(masses(terms), 1, A.shape[1])
    for t in terms.of(MASS_BLOCK):
        where = [r.index for r in t.rows]
        if A[where, :].nnz():
            out[where, :] = ca.solve(block_matrix(terms, t), ca.densify(A[where, :]))
    return out


def massless(terms: Terms) -> list[int]:
    """Velocities of positions with the mass 0, at the start values of the parameters."""
    velocities = set(velocity_of(terms).values())
    return sorted(i for i, m in mass_values(terms, terms.of(MASS)).items() if i in velocities and m == 0.0)


def typical_mass(terms: Terms) -> float:
    """The mean of the masses that are not 0, 1 where there are none."""
    found = [m for m in mass_values(terms, terms.of(MASS)).values() if m > 0.0]
    return sum(found) / len(found) if found else 1.0
