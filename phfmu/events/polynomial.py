"""The states within a step, as a linear map of its unknowns: the collocation polynomial

x(t + tau h) = x + s0 + sum_j (int_0^tau l_j) D_j,     s0: impulses at bare nodes at the start of the step;

and guards on it in Bernstein form, whose coefficients change their sign at least as often as a guard does (Descartes).
Source: Lane, Riesenfeld, BIT 21 (1981).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import comb

import numpy as np
from numpy.typing import NDArray

from phfmu.gradients.quadrature import Nodes
from phfmu.plan.layout import Layout
from phfmu.plan.planner import SchemeMaps
from phfmu.plan.unknown import INCREMENT

Array = NDArray[np.float64]


class Polynomial:
    """The polynomial of a step plan.

    state, w, node: each increment D_j with its state, its place among the unknowns, its node;
    start_state, start_w: the same of the impulses at the start
    """

    def __init__(self, layout: Layout, nodes: Nodes, maps: SchemeMaps):
        self.nodes, self.nx = nodes, layout.terms.n1
        found = [(u.index, w, u.node) for w, u in enumerate(layout.unknowns) if u.role is INCREMENT]
        self.state, self.w, self.node = (np.array([f[j] for f in found], int) for j in range(3))
        self.start_state, self.start_w = (np.array([s[j] for s in maps.jumps], int) for j in range(2))

    def __call__(self, x: Array, unknowns: Array, tau: float) -> Array:
        """States at the fraction tau of a step from x (nx) with the unknowns w (nw)."""
        weights = self.nodes.integral(tau)[self.node]
        out = x.copy()
        np.add.at(out, self.state, weights * unknowns[self.w])  # one by one, as compiled code does
        np.add.at(out, self.start_state, unknowns[self.start_w])
        return out


@dataclass(frozen=True)
class GuardFit:
    """Bernstein form of a guard over a step, by which compiled code isolates its zeros (runtime/events/event_roots.c).

    `tau` (m+1): points from 0 to 1;  `whole`, `divided`: values there, and values/tau behind 0, to Bernstein coefficients.
    """

    tau: Array
    whole: Array
    divided: Array


@cache
def guard_fit(k: int) -> GuardFit:
    """For steps with k nodes: 2k + 2 Chebyshev points with both ends."""
    m = 2 * k + 1
    tau = (1.0 - np.cos(np.pi * np.arange(m + 1) / m)) / 2.0
    return GuardFit(tau, _bernstein(tau), _bernstein(tau[1:]))


def _bernstein(tau: Array) -> Array:
    """Coefficients of the Bernstein polynomials of degree n by the values at n + 1 points."""
    n = len(tau) - 1
    return np.linalg.inv(np.array([[comb(n, i) * t**i * (1 - t) ** (n - i) for i in range(n + 1)] for t in tau]))
