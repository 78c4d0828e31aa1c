"""System transformations (phi, U): x = phi(x~), rows multiplied by U(x~)^T.

    E~ = U^T (E o phi) Dphi,  J~ = U^T (J o phi) U,  R~ = U^T (R o phi) U,  B~ = U^T (B o phi),
    z~ = U^-1 (z o phi),      H~ = H o phi.

The transformed system is a pHDAE with the same inputs, outputs and power balance.
Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, section 5.1 and appendix D.1; docs/proofs/transformations.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.declare.regular import undetermined
from phfmu.declare.variable import Variable, _sx, time

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE

Array = NDArray[Any]

ITERATIONS = 50


@dataclass(frozen=True, eq=False)
class SystemTransformation:
    """An invertible system transformation (phi, U) of some variables; all others stay as they are.

    phi:  old variable -> expression of the new ones (and of parameters), in old units
    new:  the new variables, states or algebraic variables, with units; their starts are first guesses for phi(x~) = x
    U:    (n x n), rows in the order of the old variables (stacked), columns in that of the new ones; default identity

    `T(model)` transforms a declaration; `S @ T` is S after T in the sense (phi_S o phi_T, (U_S o phi_T) U_T), applied as
    T(S(model)).  DeclarationError names what makes the pair not invertible.
    """

    phi: Mapping[Variable, Any]
    new: tuple[Variable, ...]
    U: Any = None

    def __post_init__(self) -> None:
        phi = {v: ca.SX(_sx(e)) for v, e in self.phi.items()}
        object.__setattr__(self, "phi", phi)
        object.__setattr__(self, "new", tuple(self.new))
        for v, e in phi.items():
            if e.shape != (v.n, 1):
                raise DeclarationError(f"phi of '{v.name}' is {e.shape[0]} x {e.shape[1]}, expected {v.n} x 1")
        names = f"({_listed(self.old)}) from ({_listed(self.new)})"
        n, m = sum(v.n for v in self.old), sum(v.n for v in self.new)
        if n != m:
            raise DeclarationError(
                f"phi makes {n} coordinates {names}, which have {m}: a diffeomorphism keeps their number; for a redundant "
                "description use constraints"
            )
        U = ca.SX.eye(n) if self.U is None else ca.SX(_sx(self.U))
        if U.shape != (n, n):
            raise DeclarationError(
                f"U is {U.shape[0]} x {U.shape[1]}, expected {n} x {n}: old rows x new columns {names}"
            )
        object.__setattr__(self, "U", ca.sparsify(U))
        if any(s.element_hash() == time.element_hash() for s in self.foreign):
            raise DeclarationError("phi or U depends on time; a system transformation is a function of the state only")

    @property
    def old(self) -> tuple[Variable, ...]:
        """The variables that are replaced."""
        return tuple(self.phi)

    @property
    def x(self) -> ca.SX:
        """The new variables, stacked."""
        return ca.vertcat(*(v.sx for v in self.new))

    @property
    def image(self) -> ca.SX:
        """phi(x~), stacked in the order of the old variables."""
        return ca.vertcat(*self.phi.values())

    @property
    def jacobian(self) -> ca.SX:
        """Dphi(x~)."""
        return ca.jacobian(self.image, self.x)

    @property
    def affine(self) -> bool:
        """True if Dphi does not depend on the new variables."""
        return not ca.depends_on(ca.veccat(self.jacobian), self.x)

    @property
    def foreign(self) -> tuple[ca.SX, ...]:
        """Symbols in phi and U that are not new variables: parameters of the model."""
        own = {s.element_hash() for s in ca.vertsplit(self.x)}
        found = ca.symvar(ca.vertcat(ca.vec(self.image), ca.vec(ca.SX(self.U))))
        return tuple(s for s in found if s.element_hash() not in own)

    def __call__(self, model: PHDAE) -> PHDAE:
        """The transformed declaration; starts of the new variables solve phi(x~) = x."""
        from phfmu.declare.transformed import transformed

        return transformed(model, self)

    def __matmul__(self, after: SystemTransformation) -> SystemTransformation:
        """(phi, U) o (phi~, U~) = (phi o phi~, (U o phi~) U~)."""
        if _hashes(self.new) != _hashes(after.old):
            raise DeclarationError(
                f"the first transformation makes ({_listed(self.new)}), the second one replaces ({_listed(after.old)}); "
                "list the same variables in the same order"
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
                raise DeclarationError("phi is not affine; give psi: new variable -> expression of the old ones")
            (offset,) = ca.substitute([self.image], [self.x], [ca.SX.zeros(self.x.numel())])
            value = ca.mtimes(inverted(self.jacobian), x - offset)
            parts = ca.vertsplit(value, np.cumsum([0, *(v.n for v in self.new)]).tolist())
            psi = dict(zip(self.new, parts, strict=True))
        missing = [v.name for v in self.new if v not in psi]
        if missing:
            raise DeclarationError(f"psi misses {', '.join(missing)}")
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
                f"phi(psi(x)) gives {name} = {value[worst]:.9g} instead of {start[worst]:.9g} at the start; psi is not the "
                "inverse of phi there"
            )

    def extended(self, also: Sequence[Variable]) -> SystemTransformation:
        """The same transformation with further variables mapped to themselves."""
        also = [v for v in also if v not in self.phi]
        if not also:
            return self
        phi = {**self.phi, **{v: v.sx for v in also}}
        return SystemTransformation(phi, (*self.new, *also), ca.diagcat(self.U, ca.SX.eye(sum(v.n for v in also))))


def keeping_E(phi: Mapping[Variable, Any], new: Sequence[Variable]) -> SystemTransformation:
    """The change of coordinates x = phi(x~) with U = Dphi^-T, which keeps E = I (an ODE stays an ODE).

    Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, Remark 8.
    """
    plain = SystemTransformation(phi, tuple(new))
    return SystemTransformation(phi, tuple(new), inverted(plain.jacobian).T)


def inverted(matrix: ca.SX) -> ca.SX:
    """The inverse of a matrix of expressions, block by block where rows and columns fall apart."""
    matrix = ca.sparsify(matrix)
    out = ca.SX(*matrix.shape)
    for rows, cols in blocks(matrix):
        if len(rows) != len(cols):
            raise DeclarationError("a matrix to be inverted is structurally singular")
        part = matrix[rows, cols]
        numbers = part.is_constant()
        value = ca.SX(np.linalg.inv(np.array(ca.DM(part)))) if numbers else _inverse(part)
        for r, i in enumerate(cols):
            for c, j in enumerate(rows):
                out[i, j] = value[r, c]
    return ca.sparsify(out)


def _inverse(matrix: ca.SX) -> ca.SX:
    return ca.inv_minor(matrix) if matrix.shape[0] <= 3 else ca.solve(matrix, ca.SX.eye(matrix.shape[0]))


def blocks(matrix: ca.SX) -> list[tuple[list[int], list[int]]]:
    """Connected sets of rows and columns of the sparsity pattern, in order of their first row; then lone columns."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n, m = matrix.shape
    rows, cols = matrix.sparsity().get_triplet()
    pattern = coo_matrix((np.ones(len(rows)), (rows, [n + c for c in cols])), shape=(n + m, n + m))
    count, label = connected_components(pattern, directed=False)
    found = [(np.flatnonzero(label[:n] == k).tolist(), np.flatnonzero(label[n:] == k).tolist()) for k in range(count)]
    return found


def solved_starts(T: SystemTransformation, old: Array, p: Array, parameters: ca.SX, model: str) -> Array:
    """x~ with phi(x~) = x, by Newton from the starts of the new variables.

    DeclarationError if there is none nearby, or if Dphi or U is singular there.
    """
    f = ca.Function("phi", [T.x, parameters], [T.image, ca.densify(T.jacobian), ca.densify(T.U)])
    x = np.array([s for v in T.new for s in v.start])
    names = [n for v in T.new for n in v.names()]
    size = np.array([s for v in T.old for s in v.nominal]) + np.abs(old)

    def residual(x: Array) -> tuple[Array, Array, Array]:
        value, D, U = (np.array(a) for a in f(x, p))
        return value.ravel() - old, D, U

    r, D, U = residual(x)
    for _ in range(ITERATIONS):
        if not np.isfinite(r).all() or np.max(np.abs(r) / size) <= 1e-15:
            break
        step, scale = np.linalg.lstsq(D, -r, rcond=None)[0], 1.0
        while scale > 1e-4:  # damped: the first guess may be far
            new = residual(x + scale * step)
            if np.isfinite(new[0]).all() and np.linalg.norm(new[0] / size) < np.linalg.norm(r / size):
                break
            scale /= 2
        else:
            break
        x, (r, D, U) = x + scale * step, new
    if np.isfinite(r).all():
        _require_regular({"Dphi": D, "U": U}, x, names, model)
    if not np.isfinite(r).all() or np.max(np.abs(r) / size) > 1e-9:
        worst = int(np.argmax(np.nan_to_num(np.abs(r) / size, nan=np.inf)))
        old_names = [n for v in T.old for n in v.names()]
        raise DeclarationError(
            f"{model}: no start of {', '.join(names)} found with phi(x~) = x: '{old_names[worst]}' is missed by "
            f"{r[worst]:.6g}; give the new variables starts near the solution"
        )
    return x


def _require_regular(matrices: Mapping[str, Array], x: Array, names: list[str], model: str) -> None:
    for what, matrix in matrices.items():
        column = undetermined(matrix)
        if column >= 0:
            raise DeclarationError(
                f"{model}: {what} is singular at {names[column]} = {x[column]:.6g} (singular values {_values(matrix)}); a "
                "transformation is invertible near regular points only: start elsewhere or use other coordinates"
            )


def _values(matrix: Array) -> str:
    if not np.isfinite(matrix).all():
        return "not finite"
    values = np.linalg.svd(matrix, compute_uv=False)
    return f"{values[0]:.3g} .. {values[-1]:.3g}"


def _listed(variables: Sequence[Variable]) -> str:
    return ", ".join(v.name for v in variables)


def _hashes(variables: Sequence[Variable]) -> list[int]:
    return [v.sx[0].element_hash() for v in variables]
