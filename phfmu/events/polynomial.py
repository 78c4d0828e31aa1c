"""The states within a step, as a linear map of its unknowns: the collocation polynomial

x(t + tau h) = x + s0 + sum_j (int_0^tau l_j) D_j,     s0: impulses at bare nodes at the start of the step.
"""

from __future__ import annotations

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
