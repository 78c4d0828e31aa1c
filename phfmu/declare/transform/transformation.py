"""System transformations (phi, U): x = phi(x~), rows multiplied by U(x~)^T.

    E~ = U^T (E o phi) Dphi,  J~ = U^T (J o phi) U,  R~ = U^T (R o phi) U,  B~ = U^T (B o phi),
    z~ = U^-1 (z o phi),      H~ = H o phi.

The transformed system is a pHDAE with the same inputs, outputs and power balance.
Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, section 5.1 and appendix D.1; docs/proofs/transformations.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.transform.inverse import inverted
from phfmu.declare.transform.maps import CoordinateMaps, listed
from phfmu.declare.transform.transformed import transformed
from phfmu.declare.variable import Variable, _sx


@dataclass(frozen=True, eq=False)
class SystemTransformation(CoordinateMaps):
    """An invertible system transformation (phi, U) of some variables; all others stay as they are.

    phi:  old variable -> expression of the new ones (and of parameters), in old units
    new:  the new variables, states or algebraic variables, with units; their starts are first guesses for phi(x~) = x
    U:    (n x n), rows in the order of the old variables (stacked), columns in that of the new ones; default identity

    `T(model)` transforms a declaration; `S @ T` is S after T in the sense (phi_S o phi_T, (U_S o phi_T) U_T), applied as
    T(S(model)).  DeclarationError names what makes the pair not invertible.
    """

    def __call__(self, model: PHDAE) -> PHDAE:
        """The transformed declaration; starts of the new variables solve phi(x~) = x."""
        return transformed(model, self)

    def __matmul__(self, after: SystemTransformation) -> SystemTransformation:
        """(phi, U) o (phi~, U~) = (phi o phi~, (U o phi~) U~)."""
        if _hashes(self.new) != _hashes(after.old):
            raise DeclarationError(
                "S @ T",
                f"the first transformation makes ({listed(self.new)}), the second one replaces ({listed(after.old)})",
                "list the same variables in the same order",
            )
        (phi, U) = ca.substitute([self.image, self.U], [self.x], [after.image])
        parts = ca.vertsplit(phi, np.cumsum([0, *(v.n for v in self.old)]).tolist())
        return SystemTransformation(dict(zip(self.old, parts, strict=True)), after.new, ca.mtimes(U, after.U))

    def inverse(self, psi: Mapping[Variable, Any] | None = None) -> SystemTransformation:
        """(phi^-1, U^-1 o phi^-1), from the new variables back to the old ones.

        psi: new variable -> expression of the old ones; not needed for affine phi.  DeclarationError if
        phi(psi(x)) = x does not hold at the starts of the old variables.
        """
        x = ca.vertcat(*(v.sx for v in self.old))
        if psi is None:
            if not self.affine:
                raise DeclarationError("phi", "is not affine", "give psi: new variable -> expression of the old ones")
            (offset,) = ca.substitute([self.image], [self.x], [ca.SX.zeros(self.x.numel())])
            value = ca.mtimes(inverted(self.jacobian), x - offset)
            parts = ca.vertsplit(value, np.cumsum([0, *(v.n for v in self.new)]).tolist())
            psi = dict(zip(self.new, parts, strict=True))
        missing = [v.name for v in self.new if v not in psi]
        if missing:
            raise DeclarationError("psi", f"misses {', '.join(missing)}", "give each new variable its expression")
        back = ca.vertcat(*(ca.SX(_sx(psi[v])) for v in self.new))
        round_trip, U = ca.substitute([self.image, inverted(self.U)], [self.x], [back])
        self._require_inverse(round_trip, x)
        return SystemTransformation({v: psi[v] for v in self.new}, self.old, U)

    def _require_inverse(self, round_trip: ca.SX, x: ca.SX) -> None:
        parameters = ca.vertcat(*self.foreign)
        start = np.array([s for v in self.old for s in v.start])
        p = np.random.default_rng(3).uniform(0.5, 1.5, parameters.numel())
        value = np.array(ca.Function("r", [x, parameters], [round_trip])(start, p)).ravel()
        size = np.array([s for v in self.old for s in v.nominal]) + np.abs(start)
        worst = int(np.argmax(np.where(np.isfinite(value), np.abs(value - start) / size, np.inf)))
        if not np.abs(value[worst] - start[worst]) <= 1e-9 * size[worst]:
            name = [n for v in self.old for n in v.names()][worst]
            raise DeclarationError(
                "psi",
                f"phi(psi(x)) gives {name} = {value[worst]:.9g} instead of {start[worst]:.9g} at the start; psi is not the "
                "inverse of phi there",
                "correct psi or phi",
            )


def keeping_E(phi: Mapping[Variable, Any], new: Sequence[Variable]) -> SystemTransformation:
    """The change of coordinates x = phi(x~) with U = Dphi^-T, which keeps E = I (an ODE stays an ODE).

    Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, Remark 8.
    """
    plain = SystemTransformation(phi, tuple(new))
    return SystemTransformation(phi, tuple(new), inverted(plain.jacobian).T)


def _hashes(variables: Sequence[Variable]) -> list[int]:
    return [v.sx[0].element_hash() for v in variables]
