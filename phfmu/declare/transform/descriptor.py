"""Constant singular E: the semi-explicit form by singular value decomposition.

With E = U Sigma V^T, Sigma = diag(Sigma1, 0), V = [V1, V2], U = [U1, U2] and x = V1 x1 + V2 x2:

    Sigma1 x1' = U1^T [(J - R) z + B u],    0 = U2^T [(J - R) z + B u],    z = U1 z1 + U2 z2,
    Sigma1 z1 = grad H1(x1),  H1(x1) = H(V1 x1),    z2 = U2^T z(V1 x1 + V2 x2).

Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, Proposition 2.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.entries.coefficients import square, stacked
from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.transform.inverse import blocks
from phfmu.declare.transform.regular import undetermined
from phfmu.declare.transform.transformation import SystemTransformation
from phfmu.declare.variable import Variable, _sx, algebraic, state

Array = NDArray[np.float64]

#: singular values below this fraction of the largest one are zero
REGULAR = 1e-10


def reduce_descriptor(model: PHDAE) -> PHDAE:
    """The semi-explicit form of a model whose E has constant singular blocks; other blocks stay as they are.

    A block on `v` becomes the states `v.differential` = V1^T v and the algebraic variables `v.algebraic` = V2^T v; `v`
    itself is reported as an observable.  Parts of E that do not share rows or columns keep their own coordinates.  E may
    depend on parameters as long as its kernels do not.  A model without such blocks is returned as it is.

    DeclarationError: E depends on states; its kernels depend on parameters; z of a singular block is missing, or
    E^T z != grad H; H depends on V2^T x.
    """
    for key, value in model.E.items():
        variables = stacked(key)
        matrix = square(value, sum(v.n for v in variables))
        pair = _decomposed(model, variables, matrix)
        if pair is not None:
            model = _transformation(variables, *pair)(model)
    return model


def _decomposed(model: PHDAE, variables: Sequence[Variable], matrix: ca.SX) -> tuple[Array, Array, Array, Array] | None:
    """U1, U2, V1, V2 of a singular block of E, None if it is regular; DeclarationError as `reduce_descriptor` says."""
    label = f"{model.name}: E of {', '.join(repr(v.name) for v in variables)}"
    parameters = ca.vertcat(*(p.sx for p in model.parameters))
    start = np.array([s for p in model.parameters for s in p.start])
    if ca.depends_on(ca.vec(matrix), model.x):
        x = np.array([s for v in model.states for s in v.start])
        E = np.array(ca.Function("E", [model.x, parameters], [ca.densify(matrix)])(x, start))
        if undetermined(E) >= 0:
            raise DeclarationError(
                label,
                "is singular and depends on the state; the decomposition needs a constant E",
                "use a SystemTransformation to semi-explicit form, or Parametrised for E of constant rank",
                "descriptor",
            )
        return None
    f = ca.Function("E", [parameters], [ca.densify(matrix)])
    U1, U2, V1, V2 = kernels(matrix, np.array(f(start)))
    if not V2.shape[1]:
        return None
    _require_constant_kernels(label, model, f, start, U2, V2)
    _require_costates(label, model, variables, matrix)
    return U1, U2, V1, V2


def kernels(matrix: ca.SX, E: Array) -> tuple[Array, Array, Array, Array]:
    """Orthonormal U1, U2, V1, V2, one connected part of the pattern at a time; a regular part keeps its coordinates."""
    n = len(E)
    found: tuple[list[Array], ...] = ([], [], [], [])

    def add(which: int, where: list[int], columns: Array) -> None:
        for c in columns.T:
            full = np.zeros(n)
            full[where] = c
            found[which].append(full)

    for rows, cols in blocks(matrix):
        part = E[np.ix_(rows, cols)]
        u, s, vt = np.linalg.svd(part) if part.size else (np.eye(len(rows)), np.zeros(0), np.eye(len(cols)))
        rank = int(np.count_nonzero(s > REGULAR * s.max(initial=0.0)))
        if rank == len(rows) == len(cols):
            u, vt = np.eye(rank), np.eye(rank)
        u1, v1 = _signed(u[:, :rank], vt[:rank].T)
        u2, v2 = (_signed(k, k)[0] for k in (u[:, rank:], vt[rank:].T))
        if rows == cols and np.array_equal(part, part.T):
            u2 = v2  # one kernel: z2 = V2^T z
        for which, where, columns in ((0, rows, u1), (1, rows, u2), (2, cols, v1), (3, cols, v2)):
            add(which, where, columns)
    U1, U2, V1, V2 = (np.array(c).reshape(-1, n).T for c in found)
    return U1, U2, V1, V2


def _signed(u: Array, v: Array) -> tuple[Array, Array]:
    """Both with the signs that make the first large entry of each column of v positive, in 15 digits.

    Rounding makes equal entries equal, so that what cancels in B or J cancels exactly; any regular U, V will do.
    """
    if not v.size:
        return u, v
    sign = np.sign(v[np.argmax(np.abs(v) > 0.9 * np.abs(v).max(axis=0), axis=0), range(v.shape[1])])
    u, v = u * sign, v * sign
    return np.round(u, 15) + 0.0, np.round(v, 15) + 0.0


def _require_constant_kernels(label: str, model: PHDAE, f: ca.Function, p: Array, U2: Array, V2: Array) -> None:
    rng = np.random.default_rng(5)
    names = [n for q in model.parameters for n in q.names()]
    for i in range(len(p)):
        moved = p.copy()
        moved[i] = (p[i] or 1.0) * rng.uniform(1.1, 1.5)
        E = np.array(f(moved))
        left = max(np.abs(U2.T @ E).max(initial=0.0), np.abs(E @ V2).max(initial=0.0))
        if left > REGULAR * np.abs(E).max(initial=0.0):
            raise DeclarationError(
                label,
                f"is singular at {names[i]} = {p[i]:.6g}, but its kernel changes with it (|E V2| or |U2^T E| = "
                f"{left:.3g} at {moved[i]:.6g})",
                "write numbers into E instead of this parameter",
                "descriptor",
            )


def _require_costates(label: str, model: PHDAE, variables: Sequence[Variable], matrix: ca.SX) -> None:
    missing = [v.name for v in variables if v not in model.z]
    if missing:
        raise DeclarationError(
            label,
            "is singular, so E^T z = grad H does not determine z",
            f"give z of {', '.join(missing)} in the declaration",
            "descriptor",
        )
    x = ca.vertcat(*(v.sx for v in variables))
    z = ca.vertcat(*(ca.SX(_sx(model.z[v])) for v in variables))
    grad = ca.gradient(model.hamiltonian, x)
    symbols = [model.x, ca.vertcat(*(p.sx for p in model.parameters))]
    parts = ca.mtimes(ca.fabs(matrix).T, ca.fabs(z)) + ca.fabs(grad)
    f = ca.Function("c", symbols, [ca.densify(ca.mtimes(matrix.T, z) - grad), ca.densify(parts)])
    start = np.array([s for v in model.states for s in v.start])
    size = np.maximum(np.abs(start), [s for v in model.states for s in v.nominal])
    p = np.array([s for q in model.parameters for s in q.start])
    rng = np.random.default_rng(6)
    names = [n for v in variables for n in v.names()]
    for _ in range(3):
        defect, scale = (np.array(a).ravel() for a in f(start + 0.3 * size * rng.uniform(-1, 1, len(size)), p))
        bad = np.flatnonzero(np.abs(defect) > 1e-9 * scale)
        if bad.size:
            raise DeclarationError(
                label,
                f"E^T z - grad H = {defect[bad[0]]:.6g} at '{names[bad[0]]}' (parts of {scale[bad[0]]:.3g})",
                "correct z, E or H",
                "costate",
            )


def _transformation(variables: Sequence[Variable], U1: Array, U2: Array, V1: Array, V2: Array) -> SystemTransformation:
    name = "_".join(v.name for v in variables)
    units = {v.unit for v in variables}
    unit = units.pop() if len(units) == 1 else "1"
    x0 = np.array([s for v in variables for s in v.start])
    nominal = np.array([s for v in variables for s in v.nominal])
    new: list[Variable] = []
    for V, make, part, text in (
        (V1, state, "differential", "coordinates in the row space of E"),
        (V2, algebraic, "algebraic", "coordinates in the kernel of E"),
    ):
        n = V.shape[1]
        if n:
            size = [float(nominal[np.abs(c) > 0].max()) for c in V.T]
            new.append(make(f"{name}.{part}", n if n > 1 else None, unit=unit, start=(V.T @ x0).tolist(), nominal=size,
                            description=f"{text} of {', '.join(v.name for v in variables)}"))  # fmt: skip
    image = ca.mtimes(ca.sparsify(ca.DM(np.hstack([V1, V2]))), ca.vertcat(*(v.sx for v in new)))
    parts = ca.vertsplit(image, np.cumsum([0, *(v.n for v in variables)]).tolist())
    U = ca.SX(ca.sparsify(ca.DM(np.hstack([U1, U2]))))
    return SystemTransformation(dict(zip(variables, parts, strict=True)), tuple(new), U)
