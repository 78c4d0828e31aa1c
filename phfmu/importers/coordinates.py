"""Coordinates in which a linear port-Hamiltonian system is stepped.

With regular [U1, U2] and [V1, V2], x = V1 x1 + V2 x2, E V2 = 0, U2^T E = 0 and z = Q x = U1 z1 + U2 z2:

    E1 x1' = U1^T [(J - R) z + (G - P) u],   0 = U2^T [(J - R) z + (G - P) u],   E1 = U1^T E V1,
    E1^T z1 = H1 x1,   H = 1/2 x1^T H1 x1,   H1 = V1^T E^T Q V1,

and z2 are the algebraic variables: x2 = Q22^-1 (z2 - U2^T Q V1 x1) with Q22 = U2^T Q V2 is needed for reports only.
Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, Proposition 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.declare.transform.descriptor import kernels
from phfmu.importers.definite import RELATIVE, Sparse, csc, in_words
from phfmu.importers.given import DescriptorSystem, symbolic

Array = NDArray[Any]
#: eigenvalues of the balanced Hessian below this fraction of the largest belong to states without energy
EMPTY = 1e-13


@dataclass(frozen=True, eq=False)
class Coordinates:
    """U1, U2, V1, V2 and the system in them: E1, H1 on x1; J, R on (z1, z2); G, P on (z1, z2) and u."""

    U1: Sparse
    U2: Sparse
    V1: Sparse
    V2: Sparse
    E1: Sparse
    H1: Sparse
    J: Sparse
    R: Sparse
    G: Sparse
    P: Sparse

    @property
    def n1(self) -> int:
        return self.V1.shape[1]

    @property
    def n2(self) -> int:
        return self.V2.shape[1]

    def states(self, Q: Sparse) -> tuple[Sparse, Sparse]:
        """M1, M2 with x = M1 x1 + M2 z2."""
        if not self.n2:
            return self.V1, self.V2
        inverse = np.linalg.inv((self.U2.T @ Q @ self.V2).toarray())
        V2 = csc(self.V2 @ csc(inverse))
        return csc(self.V1 - V2 @ (self.U2.T @ Q @ self.V1)), V2


def semi_explicit(model: str, given: DescriptorSystem, names: Sequence[str]) -> Coordinates:
    """The semi-explicit form; regular parts of E keep their coordinates, all of them if E is regular.

    DeclarationError: x along some direction occurs neither in E x nor in Q x.
    """
    n = given.E.shape[0]
    if not given.E.nnz and not n:
        raise DeclarationError(model, "has no states", "give J with a row for each", "shape")
    U1, U2, V1, V2 = (csc(m) for m in kernels(symbolic(given.E), given.E.toarray()))
    if V2.shape[1] == 0:
        identity = csc(sp.eye(n))
        return _projected(given, identity, U2, identity, V2)
    order = _first(V1)
    U1, V1, U2, V2 = U1[:, order], V1[:, order], U2[:, _first(U2)], V2[:, _first(V2)]
    Q22 = (U2.T @ given.Q @ V2).toarray()
    _, s, vt = np.linalg.svd(Q22)
    if s[-1] <= RELATIVE * s[0]:
        reason = (
            f"E v = 0 and Q v = 0 for v = {in_words(V2 @ vt[-1], names)}: no equation determines the states along v"
        )
        raise DeclarationError(model, reason, "leave them out of x", "singular")
    return _projected(given, U1, U2, V1, V2)


def with_energy_states(given: DescriptorSystem, c: Coordinates) -> Coordinates:
    """Coordinates with E1 = I, H1 = diag(1, .., 1, 0, .., 0) and R diagonal where H1 is 1.

    H1 = D C D with the diagonal of C = 1, so that units do not count, and C = W diag(c) W^T:  x1~ = diag(sqrt c) W^T D x1.
    """
    H = c.H1.toarray()
    D = np.sqrt(np.where(np.diag(H) > 0, np.diag(H), 1.0))
    values, W = np.linalg.eigh(H / np.outer(D, D))
    values, W = values[::-1], W[:, ::-1]
    r = int(np.count_nonzero(values > EMPTY * values[0]))
    root = np.where(np.arange(len(D)) < r, np.sqrt(np.where(values > 0, values, 1.0)), 1.0)
    T, inverse = (root[:, None] * W.T) * D, W / root / D[:, None]
    U = np.linalg.solve(c.E1.toarray(), np.eye(len(D))).T @ T.T
    U = c.U1 @ U
    R = U.T @ (given.R @ U)
    _, O = np.linalg.eigh((R + R.T)[:r, :r] / 2)
    U[:, :r], inverse[:, :r] = U[:, :r] @ O, inverse[:, :r] @ O
    made = _projected(given, csc(U), c.U2, csc(c.V1 @ inverse), c.V2)
    R = made.R.tolil()
    R[:r, :r] = np.diag(
        np.maximum(R[:r, :r].diagonal(), 0.0)
    )  # what the rotation leaves beside the diagonal is rounding
    return replace(
        made,
        E1=csc(sp.eye(len(D))),
        H1=csc(sp.diags((np.arange(len(D)) < r) * 1.0)),
        R=csc(R),
    )


def _projected(given: DescriptorSystem, U1: Sparse, U2: Sparse, V1: Sparse, V2: Sparse) -> Coordinates:
    U = csc(sp.hstack([U1, U2]))
    J, R, H = U.T @ given.J @ U, U.T @ given.R @ U, V1.T @ given.H @ V1
    return Coordinates(
        U1, U2, V1, V2, csc(U1.T @ given.E @ V1), _exact(H, 1), _exact(J, -1), _exact(R, 1),
        csc(U.T @ given.G), csc(U.T @ given.P),
    )  # fmt: skip


def _exact(matrix: Sparse, sign: int) -> Sparse:
    """The symmetric (or skew) part: products round."""
    made = csc((matrix + sign * matrix.T) / 2)
    made.eliminate_zeros()
    return made


def _first(columns: Sparse) -> Array:
    """Order of columns by their first large entry."""
    size = np.abs(columns.toarray())
    return np.argsort(np.argmax(size > 0.9 * size.max(axis=0, initial=0.0), axis=0), kind="stable")
