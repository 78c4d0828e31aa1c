"""Matrices as they are given: read, compared with each other, and refused where they are not port-Hamiltonian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from phfmu.declare.error import DeclarationError, Problem
from phfmu.importers.definite import RELATIVE, Sparse, csc, descent, in_words


@dataclass(frozen=True, eq=False)
class DescriptorSystem:
    """E x' = (J - R) Q x + (G - P) u, y = (G + P)^T Q x + (S - N) u; all matrices sparse, with zeros left out."""

    E: Sparse
    J: Sparse
    R: Sparse
    Q: Sparse
    G: Sparse
    P: Sparse
    S: Sparse
    N: Sparse

    @property
    def H(self) -> Sparse:
        """E^T Q, the Hessian of the energy."""
        return csc(self.E.T @ self.Q)

    @property
    def W(self) -> Sparse:
        """[R, P; P^T, S]."""
        return csc(sp.bmat([[self.R, self.P], [self.P.T, self.S]]))


def read(name: str, **found: Any) -> DescriptorSystem:
    """The matrices of numbers behind `found`, None for absent ones; DeclarationError if shapes or values do not fit."""
    J = _matrix(name, "J", found["J"])
    n = J.shape[0]
    G = csc((n, 0)) if found["G"] is None else _matrix(name, "G", found["G"])
    m = G.shape[1]
    shapes = {"E": (n, n), "J": (n, n), "R": (n, n), "Q": (n, n), "G": (n, m), "P": (n, m), "S": (m, m), "N": (m, m)}
    made = {}
    for what, shape in shapes.items():
        if found[what] is None:
            made[what] = csc(sp.eye(n)) if what in ("E", "Q") else csc(shape)
        else:
            made[what] = _matrix(name, what, found[what], shape if what in "GPSN" else None)
    made["G"] = G if found["G"] is not None else made["G"]
    wrong = [
        Problem("shape", f"{name}: {k}", f"is {v.shape[0]} x {v.shape[1]}, expected {shapes[k][0]} x {shapes[k][1]}",
                f"J gives the {n} states, G the {m} inputs (columns)")
        for k, v in made.items() if v.shape != shapes[k]
    ]  # fmt: skip
    if wrong:
        raise DeclarationError.of(wrong)
    return DescriptorSystem(**made)


def _matrix(model: str, what: str, value: Any, shape: tuple[int, int] | None = None) -> Sparse:
    """A sparse matrix of real numbers; a vector is a column, and a number a 1 x 1 matrix."""
    try:
        if not sp.issparse(value):
            value = np.asarray(value)
            value = value.reshape(-1, 1) if value.ndim < 2 else value
        made = csc(value)
        if np.iscomplexobj(made.data) and np.any(made.data.imag):
            raise ValueError("it is complex")
        made = csc(made.real, dtype=float)
    except (TypeError, ValueError) as error:
        raise DeclarationError(f"{model}: {what}", f"is no matrix of real numbers ({error})",
                               "give a NumPy array or a SciPy sparse matrix", "type") from None  # fmt: skip
    if not np.isfinite(made.data).all():
        r, c = (int(i[0]) for i in np.where(~np.isfinite(made.toarray())))
        raise DeclarationError(
            f"{model}: {what}", f"its entry [{r + 1}, {c + 1}] is {made[r, c]}", "give finite numbers", "start"
        )
    made.eliminate_zeros()
    return made


def port_hamiltonian(
    name: str, given: DescriptorSystem, states: Sequence[str], inputs: Sequence[str]
) -> DescriptorSystem:
    """`given` without rounding errors of its symmetries; DeclarationError lists everything that is not port-Hamiltonian."""
    hessian = "it is the Hessian of H = 1/2 x^T E^T Q x"
    found = [
        *_mirrored(name, "J", given.J, -1, states, "the symmetric part of J - R belongs into -R"),
        *_mirrored(name, "N", given.N, -1, inputs, "the symmetric part of a feedthrough S - N is S"),
        *_mirrored(name, "R", given.R, +1, states, "the skew part of J - R belongs into J"),
        *_mirrored(name, "S", given.S, +1, inputs, "the skew part of a feedthrough S - N is -N"),
        *_mirrored(name, "E^T Q", given.H, +1, states, f"{hessian}: choose Q so that it is"),
    ]
    if not found:
        what = "[R, P; P^T, S]" if given.P.nnz or given.S.nnz else "R"
        remedy = "correct the sign of what feeds energy in, or let it act through a port"
        found += _indefinite(name, what, given.W, [*states, *inputs], "passivity", remedy)
        remedy = f"{hessian}: choose another Q (for a stable system: a solution of its Lyapunov inequality)"
        found += _indefinite(name, "E^T Q", given.H, states, "energy", remedy)
    if found:
        raise DeclarationError.of(found)
    half = {what: csc((m - m.T) / 2) for what, m in (("J", given.J), ("N", given.N))}
    half |= {what: csc((m + m.T) / 2) for what, m in (("R", given.R), ("S", given.S))}
    return replace(given, **half)


def _mirrored(model: str, what: str, matrix: Sparse, sign: int, names: Sequence[str], remedy: str) -> list[Problem]:
    """Entries at which M differs from sign M^T by more than rounding."""
    defect = sp.coo_matrix(matrix - sign * matrix.T)
    if not defect.nnz:
        return []
    worst = int(np.argmax(np.abs(defect.data)))
    if abs(defect.data[worst]) <= RELATIVE * abs(matrix).max():
        return []
    i, j = sorted((int(defect.row[worst]), int(defect.col[worst])))
    rule, kind = ("symmetry", "symmetric") if sign > 0 else ("skew", "skew-symmetric")
    other = f", [{names[j]}, {names[i]}] = {matrix[j, i]:.6g}" if i != j else ""
    reason = f"is not {kind}: [{names[i]}, {names[j]}] = {matrix[i, j]:.6g}{other}"
    return [Problem(rule, f"{model}: {what}", reason, remedy)]


def _indefinite(model: str, what: str, matrix: Sparse, names: Sequence[str], rule: str, remedy: str) -> list[Problem]:
    found = descent(csc((matrix + matrix.T) / 2))
    if found is None:
        return []
    value, v = found
    reason = f"is not positive semidefinite: v^T M v = {value:.6g} for v = {in_words(v, names)}"
    return [Problem(rule, f"{model}: {what}", reason, remedy)]


def symbolic(matrix: Sparse) -> ca.SX:
    """The matrix as an expression (CasADi's own conversion wants sorted columns and ends the process without them)."""
    m = sp.coo_matrix(matrix)
    return ca.SX(ca.DM.triplet(m.row.tolist(), m.col.tolist(), ca.DM(m.data), *m.shape))
