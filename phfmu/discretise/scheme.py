"""What the step plan asks of a scheme, and the parts that schemes with k nodes share."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from phfmu.discretise.layout import Layout
from phfmu.discretise.planner import Maps
from phfmu.discretise.quadrature import Nodes
from phfmu.discretise.spec import Spec
from phfmu.discretise.terms import Term, Terms

Unknown = tuple[str, int, int]
Triplet = tuple[int, int, float, int]


class Scheme(Protocol):
    """A one-step method: which unknowns it has and what kernels each kind of term becomes.

    `name` and `gradient` as users say them;  `nodes`: where inputs are taken and outputs are averaged;  `order`: of x.
    """

    @property
    def name(self) -> str: ...
    @property
    def gradient(self) -> str: ...
    @property
    def order(self) -> int: ...
    @property
    def nodes(self) -> Nodes: ...
    @property
    def joint(self) -> bool:
        """One gradient over all states of a member."""
        ...

    def prepare(self, terms: Terms) -> Terms:
        """The terms to discretise; DeclarationError says what fits a model that this scheme does not."""
        ...

    def unknowns(self, terms: Terms) -> list[Unknown]:
        """(kind, global index, node) of every unknown; see `Layout`."""
        ...

    def specs(self, term: Term) -> list[Spec]:
        """Kernels of one term; terms of equal key get the same."""
        ...

    def constants(self, layout: Layout) -> list[Triplet]:
        """Constant entries (row, Y index, value, power of h)."""
        ...

    def maps(self, layout: Layout) -> Maps:
        """Update of the states, means of the algebraic variables, start values of the next step."""
        ...


def node_unknowns(terms: Terms, k: int) -> list[Unknown]:
    """Increments D, solved costates Z and algebraic variables a at every node."""
    out: list[Unknown] = []
    for node in range(k):
        out += [("D", i, node) for i in range(terms.n1)]
        out += [("Z", i, node) for i in (*terms.solved_costates, *terms.light)]
        out += [("a", i, node) for i in range(terms.na)]
    return out


def node_constants(layout: Layout) -> list[Triplet]:
    """Identity rows of E, E^T z = W rows, and the constant entries of (J - R) z + B u at every node."""
    terms, out = layout.terms, []
    other = {i for t in terms.terms if t.kind in ("mass", "massblock", "closed") for _, i in t.rows}
    for node in range(layout.k):
        for i in range(terms.n1):
            if i not in other:
                out.append((layout.row("x", i, node), layout.value("D", i, node), 1.0, 0))
        for i in terms.solved_costates:
            out.append((layout.w_of[("Z", i, node)], layout.nv + layout.slot(i, node), -1.0, 0))
        for row_kind, row, kind, source, value in terms.constants:
            sign = 1.0 if row_kind == "y" else -1.0
            out.append(
                (layout.row(row_kind, row, node), layout.value(kind, source, node), sign * value, int(row_kind == "x"))
            )
    return out


def node_maps(layout: Layout, nd: Nodes) -> Maps:
    """x' = x + sum b_i D_i, means sum b_i a_i, and the last step's polynomial extrapolated."""
    update, mean, guess = [], [], []
    ahead = np.array([nd.value(1.0 + c) for c in nd.c])  # extrapolate the last step's polynomial
    for w, (kind, i, node) in enumerate(layout.unknowns):
        if kind == "D":
            update.append((i, w, float(nd.b[node])))
        elif kind == "a":
            mean.append((i, w, float(nd.b[node]), 0))
        if kind not in ("D", "Z", "a"):
            guess.append([(w, 1.0, 0)])
        else:
            last = [layout.w_of[(kind, i, j)] for j in range(layout.k)]
            guess.append([(last[j], float(ahead[node, j]), int(kind == "D")) for j in range(layout.k)])
    return Maps(update, mean, guess, nd.b, nd.c)
