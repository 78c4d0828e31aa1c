"""Discrete gradient pairs as functions of two points, and what a system transformation makes of them.

A discrete gradient pair (Ebar, zbar) for (H, E, z) has

    zbar(x, x')^T Ebar(x, x') (x' - x) = H(x') - H(x),      Ebar(x, x) = E(x),   zbar(x, x) = z(x),

and with consistent Jbar (skew), Rbar (symmetric, semidefinite), Bbar it gives the scheme

    Ebar (x' - x) = h [(Jbar - Rbar) zbar + Bbar u],      y = Bbar^T zbar.

Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, Definition 9, (18), Theorems 6 and 9, Lemma 3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca

from phfmu.declare.energy import ClosedPair
from phfmu.declare.entries.coefficients import square, stacked
from phfmu.declare.entries.matrices import matrices
from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.transform.change import VariableChange
from phfmu.declare.transform.inverse import inverted
from phfmu.declare.transform.maps import CoordinateMaps
from phfmu.declare.transform.transformation import SystemTransformation
from phfmu.declare.transform.transformed import transformed
from phfmu.declare.variable import Variable, VariableKind, key, slices
from phfmu.gradients.discrete import discrete_gradient, discrete_jacobian

TwoPointMatrix = Callable[[ca.SX, ca.SX], ca.SX]


@dataclass(frozen=True, eq=False)
class DiscretePair:
    """The coefficients of one step as expressions of x and x1 (n x 1): E, J, R (n x n), z (n x 1), B (n x m)."""

    x: ca.SX
    x1: ca.SX
    E: ca.SX
    z: ca.SX
    J: ca.SX
    R: ca.SX
    B: ca.SX

    def residual(self, h: ca.SX, u: ca.SX) -> ca.SX:
        """E (x1 - x) - h [(J - R) z + B u], scheme (18)."""
        right = ca.mtimes(self.J - self.R, self.z) + ca.mtimes(self.B, u)
        return ca.mtimes(self.E, self.x1 - self.x) - h * right

    def transformed(
        self, T: SystemTransformation, Dphi: TwoPointMatrix | None = None, U: TwoPointMatrix | None = None
    ) -> DiscretePair:
        """The pair and coefficients in the new coordinates (Theorems 6 and 9).

            Ubar^T (Ebar o phi) Dphi,   Ubar^-1 (zbar o phi),   Ubar^T (Jbar o phi) Ubar, ..

        Dphi(x~, x1~): a discrete Jacobian of phi (default: mean value);  U(x~, x1~): a consistent approximation of U
        (default: at the midpoint).  The variables of this pair are the old ones of `T`, in its order.
        """
        x, x1 = ca.SX.sym("x~", T.x.numel()), ca.SX.sym("x1~", T.x.numel())
        D = discrete_jacobian(T.image, T.x)(x, x1) if Dphi is None else Dphi(x, x1)
        (middle,) = ca.substitute([T.U], [T.x], [(x + x1) / 2])
        V = middle if U is None else U(x, x1)
        ends = [ca.substitute([T.image], [T.x], [point])[0] for point in (x, x1)]
        old = ca.vertcat(self.x, self.x1)
        E, z, J, R, B = ca.substitute([self.E, self.z, self.J, self.R, self.B], [old], [ca.vertcat(*ends)])
        return DiscretePair(
            x, x1, ca.mtimes([V.T, E, D]), ca.mtimes(inverted(V), z), ca.mtimes([V.T, J, V]), ca.mtimes([V.T, R, V]),
            ca.mtimes(V.T, B),
        )  # fmt: skip


def discrete_pair(model: PHDAE, method: str = "per-term") -> DiscretePair:
    """The pair (30) of a semi-explicit declaration: a discrete gradient `method`, all else at the midpoint.

        Ebar = diag(E11, 0),   zbar = (E11^-T grad_d H1, z2),   all of J, R, B in one matrix

    Variables: states, then algebraic variables.  Parameters have their start values.  Holonomic constraints are not
    part of it (their discrete Jacobian is); bound ports and sources neither.
    """
    variables = (*model.states, *model.algebraics)
    x = ca.vertcat(*(v.sx for v in variables))
    n, n1 = x.numel(), model.x.numel()
    x1 = ca.SX.sym("x1", n)
    grad = discrete_gradient(list(model.energies), list(model.states), method, parameters=list(model.parameters))
    p = ca.vertcat(*(v.sx for v in model.parameters))
    values = ca.DM([s for v in model.parameters for s in v.start])
    middle = (x + x1) / 2
    whole = matrices(model)
    z2 = ca.vertcat(ca.SX(0, 1), *(model.effort(v) for v in model.algebraics))
    symbols = ca.vertcat(x, p)
    E, J, R, B, z2 = ca.substitute([whole.E, whole.J, whole.R, whole.B, z2], [symbols], [ca.vertcat(middle, values)])
    z1 = ca.solve(E.T, grad(x[:n1], x1[:n1], values))
    costates = ca.vertcat(ca.SX(0, 1), *(v.z for v in model.states))
    J, R, B, z2 = ca.substitute([J, R, B, z2], [costates], [z1]) if n1 else [J, R, B, z2]
    return DiscretePair(x, x1, ca.diagcat(E, ca.SX(n - n1, n - n1)), ca.vertcat(z1, z2), J, R, B)


def inverse_jacobian(T: SystemTransformation, inverse: SystemTransformation, Dphi: TwoPointMatrix) -> TwoPointMatrix:
    """The discrete Jacobian (Dphi o phi^-1)^-1 of phi^-1, for a pointwise invertible Dphi (Lemma 3).

    `inverse`: `T.inverse(...)`.  With it and U^-1 the pair transformed forth and back is the pair itself.
    """

    def D(x: ca.SX, x1: ca.SX) -> ca.SX:
        ends = [ca.substitute([inverse.image], [inverse.x], [point])[0] for point in (x, x1)]
        return inverted(Dphi(*ends))

    return D


def with_closed_pair(model: PHDAE, T: SystemTransformation, method: str = "per-term") -> PHDAE:
    """`T(model)` with the discrete gradient pair of the old coordinates, so that phi(x~_k) = x_k for all steps.

        ebar = U^T E [phi(x~ + d) - phi(x~)],      zbar = U^-1 E^-T grad_d H(phi(x~), phi(x~ + d))      (order 2)

    For phi of states with constant E and U and terms of H that depend on replaced states only.  The steps agree if J, R
    and B do not depend on replaced states; the balance is exact in any case.  DeclarationError says what does not fit.
    """
    change = VariableChange(model, T)
    maps, old = change.T, change.old
    x = ca.vertcat(*(v.sx for v in old))
    E = _constant_descriptor(model, maps, old)
    own = [e for e in model.energies if ca.depends_on(e.expr, x)]
    rest = [v for v in model.states if not ca.depends_on(v.sx, x)]
    for e in own:
        other = [v.name for v in rest if ca.depends_on(e.expr, v.sx)]
        if other:
            raise DeclarationError(
                model.name,
                f"a term of H joins replaced states with {', '.join(other)}",
                "replace these too (by themselves)",
            )
    p = ca.vertcat(ca.SX(0, 1), *(v.sx for v in model.parameters))
    grad = discrete_gradient(own, list(old), method, parameters=list(model.parameters))
    left, right = ca.mtimes(maps.U.T, E), ca.mtimes(inverted(maps.U), inverted(E).T)

    def image(point: ca.SX) -> ca.SX:
        return ca.substitute([maps.image], [maps.x], [point])[0]

    total = ca.SX(0)
    for e in own:
        total += e.expr
    h, slope = ca.substitute([total, ca.gradient(total, x)], [x], [maps.image])
    result = transformed(replace(model, energies=tuple(e for e in model.energies if e not in own), z={}), maps)
    pair = ClosedPair(
        tuple(v for v in result.states if any(ca.is_equal(v.sx[0], w.sx[0]) for w in change.new)),
        hamiltonian=h,
        E=ca.mtimes(left, maps.jacobian),
        z=ca.mtimes(right, slope),
        ebar=lambda point, d: ca.mtimes(left, image(point + d) - image(point)),
        zbar=lambda point, d: ca.mtimes(right, grad(image(point), image(point + d), p)),
    )
    new = {id(v) for v in pair.variables}
    kept = {k: m for k, m in result.E.items() if not any(id(v) in new for v in stacked(k))}
    gone = {key(v) for v in old}
    given = {v: e for v, e in model.z.items() if key(v) not in gone}
    return replace(result, closed=(*result.closed, pair), E=kept, z=given)


def _constant_descriptor(model: PHDAE, maps: CoordinateMaps, old: tuple[Variable, ...]) -> ca.SX:
    bad = [v.name for v in (*old, *maps.new) if v.kind is not VariableKind.STATE]
    if bad or ca.depends_on(ca.vec(maps.U), maps.x):
        what = f"{', '.join(bad)} is algebraic" if bad else "U depends on the state"
        raise DeclarationError(
            model.name,
            f"a closed-form pair is for states and constant U; {what}",
            "leave these variables as they are, or use `T(model)` without a pair",
        )
    place = slices(old)
    E = ca.SX.eye(sum(v.n for v in old))
    for where, value in model.E.items():
        index = [i for v in stacked(where) if key(v) in place for i in range(place[key(v)].start, place[key(v)].stop)]
        if index:
            E[index, index] = square(value, len(index))
    if ca.depends_on(ca.vec(E), model.x):
        raise DeclarationError(
            model.name,
            f"a closed-form pair needs a constant E of {', '.join(v.name for v in old)}",
            "use `T(model)` without a pair",
            "descriptor",
        )
    return E
