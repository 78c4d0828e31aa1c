"""Quadrature on [0, 1] and the collocation coefficients of k Gauss or Radau nodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import Legendre, Polynomial
from numpy.typing import ArrayLike, NDArray


@cache
def gauss(m: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nodes and weights of the m-point Gauss rule on [0, 1], exact up to degree 2m - 1."""
    t, w = np.polynomial.legendre.leggauss(m)
    return (t + 1.0) / 2.0, w / 2.0


@dataclass(frozen=True)
class Nodes:
    """k nodes c, weights b, a_ij = int_0^{c_i} l_j, with the Lagrange basis l_j on the nodes."""

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
    return _collocation(c, b)


def gauss_nodes(places: ArrayLike) -> Nodes | None:
    """The Gauss nodes at these places; None if they are others, or there are none."""
    k = np.size(places)
    return nodes(k) if k and np.allclose(places, nodes(k).c, rtol=0, atol=1e-12) else None


@cache
def radau_nodes(k: int) -> Nodes:
    """The k right Radau nodes (Radau IIA): the last one is the end of the step; exact up to degree 2k - 2."""
    roots = (Legendre.basis(k - 1) - Legendre.basis(k)).roots()
    return _collocation(np.append((np.sort(roots.real)[:-1] + 1.0) / 2.0, 1.0))


def _collocation(c: NDArray[np.float64], b: NDArray[np.float64] | None = None) -> Nodes:
    """Basis and coefficients of the nodes c; weights int_0^1 l_j unless given."""
    basis = []
    for j in range(len(c)):
        p = Polynomial([1.0])
        for i in range(len(c)):
            if i != j:
                p = p * Polynomial([-c[i], 1.0]) / (c[j] - c[i])
        basis.append(p)
    a = np.array([[p.integ()(ci) for p in basis] for ci in c])
    return Nodes(len(c), c, np.array([p.integ()(1.0) for p in basis]) if b is None else b, a, tuple(basis))
