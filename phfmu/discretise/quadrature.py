"""Gauss quadrature on [0, 1] and the collocation coefficients of k Gauss nodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray


@cache
def gauss(m: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nodes and weights of the m-point Gauss rule on [0, 1], exact up to degree 2m - 1."""
    t, w = np.polynomial.legendre.leggauss(m)
    return (t + 1.0) / 2.0, w / 2.0


@dataclass(frozen=True)
class Nodes:
    """k Gauss nodes c, weights b, a_ij = int_0^{c_i} l_j, with the Lagrange basis l_j on the nodes."""

    k: int
    c: NDArray[np.float64]
    b: NDArray[np.float64]
    a: NDArray[np.float64]
    basis: tuple[Polynomial, ...]

    def value(self, t: float) -> NDArray[np.float64]:
        """l_j(t) for all j."""
        return np.array([p(t) for p in self.basis])

    def integral(self, t: float) -> NDArray[np.float64]:
        """int_0^t l_j for all j."""
        return np.array([p.integ()(t) for p in self.basis])


@cache
def nodes(k: int) -> Nodes:
    """The k Gauss nodes; k = 1 is the midpoint."""
    c, b = gauss(k)
    basis = []
    for j in range(k):
        p = Polynomial([1.0])
        for i in range(k):
            if i != j:
                p = p * Polynomial([-c[i], 1.0]) / (c[j] - c[i])
        basis.append(p)
    a = np.array([[p.integ()(ci) for p in basis] for ci in c])
    return Nodes(k, c, b, a, tuple(basis))
