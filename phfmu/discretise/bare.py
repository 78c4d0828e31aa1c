"""Bare nodes: algebraic rows that join inductive branches only, and what a step does about them.

The row of such a node, c(x) = -L(x)^T z = 0, contains no algebraic variable (index 2); v acts on the states by x' = L v.

    pair         neutral impulses at both ends of the step (`impulses.py`): needs (dL/dx) L = 0, (dS/dx) L = 0, S = L^T H'' L
    projection   one impulse at the end of the step, whose loss is booked: needs (dL/dx) L = 0
    none         neither fits; the node is met by the nodes of the scheme only
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

from phfmu.discretise.hidden import hidden_rows
from phfmu.discretise.rows import costate_symbols, costates, row_expressions
from phfmu.discretise.terms import Locator, Term, Terms, components, make_term

Remedy = Literal["pair", "projection", "none"]


@dataclass(frozen=True)
class BareNode:
    """A bare algebraic row, what is done about it, and why not more (empty for a pair)."""

    row: int
    name: str
    remedy: Remedy
    reason: str = ""


def bare_nodes(terms: Terms) -> list[BareNode]:
    """Rows of nodes that join inductive branches only and whose currents depend on the state nonlinearly.

    A row that is linear in the state (constant L, quadratic H) stays at its start value and needs nothing.
    """
    return Finder(terms).nodes


class Finder:
    """Symbolic form of the bare rows of a model."""

    def __init__(self, terms: Terms):
        self.terms, self.nodes = terms, []
        hidden = hidden_rows(terms)
        holonomic = {t.rows[0][1] for t in terms.terms if t.kind == "constraint"}
        rows = [r for r in hidden.checks if r not in holonomic]
        if not rows:
            return
        model = terms.model
        self.x, self.z = model.x, costate_symbols(model)
        self.expr = row_expressions(terms, rows, self.z)
        self.L = {r: -ca.jacobian(self.expr[r], self.z) for r in rows}
        self.owner = _state_owners(terms)
        names = [n for v in model.algebraics for n in v.names()]
        self.hessian = ca.hessian(model.hamiltonian, self.x)[0]
        z = costates(terms)
        linear = {r for r in rows if self._linear(r, z)}
        for cluster in self._clusters(rows):
            if not linear.issuperset(cluster):
                remedy, reason = self._remedy(cluster, names)
                self.nodes += [BareNode(r, names[r], remedy, reason) for r in cluster]

    def _states(self, r: int) -> set[int]:
        return set(self.L[r].sparsity().get_triplet()[1])

    def _clusters(self, rows: list[int]) -> list[list[int]]:
        """Rows that S = L^T H'' L couples: they share branches or mutual inductances."""
        L = ca.vertcat(*(self.L[r] for r in rows))
        pattern = ca.mtimes([L, self.hessian, L.T]) + ca.SX.eye(len(rows))
        return [[rows[i] for i in part] for part in components(pattern)]

    def _linear(self, r: int, z: ca.SX) -> bool:
        c = ca.mtimes(self.L[r], z)
        return not ca.depends_on(ca.simplify(ca.jacobian(c, self.x)), self.x)

    def _remedy(self, cluster: list[int], names: list[str]) -> tuple[Remedy, str]:
        terms, states = self.terms, sorted(set().union(*(self._states(r) for r in cluster)))
        state_names = [n for v in terms.model.states for n in v.names()]
        special = {i for t in terms.terms if t.kind in ("mass", "massblock", "closed") for _, i in t.rows}
        for i in states:
            if i in special:
                return "none", f"the row of {state_names[i]} has E other than identity"
            if i not in self.owner:
                return "none", f"{state_names[i]} stores no energy"
        psi = ca.vertcat(*(self.x[i] for i in states))
        algebraics = ca.vertcat(*(v.sx for v in terms.model.algebraics))
        for r in cluster:
            if ca.depends_on(self.expr[r], algebraics) or ca.depends_on(self.L[r], self.z):
                return "none", f"the row of {names[r]} contains other algebraic variables"
            if _depends(self.L[r], psi):
                return "none", f"the coefficients of {names[r]} depend on the states they act on"
        L = ca.vertcat(*(self.L[r] for r in cluster))
        S = ca.mtimes([L, self.hessian, L.T])
        if self._singular(S):
            return "none", "its inductance matrix is singular (isolated neutral)"
        if _depends(S, psi):
            return "projection", "the stored energy is not quadratic in the states of its branches (saturation)"
        return "pair", ""

    def _singular(self, S: ca.SX) -> bool:
        """At the start values."""
        model = self.terms.model
        function = ca.Function("S", [self.x, *(p.sx for p in model.parameters)], [S])
        start = [np.array([s for v in model.states for s in v.start]), *(p.start for p in model.parameters)]
        values = np.linalg.eigvalsh(np.array(function(*start)))
        return not values[0] > 1e-12 * values[-1]

    def impulse_terms(self, remedy: Remedy) -> list[Term]:
        """One term per member and cluster with this remedy: L, its part c of the rows, and S, in the member's states."""
        rows = [n.row for n in self.nodes if n.remedy == remedy]
        if not rows:
            return []
        terms, model = self.terms, self.terms.model
        locator = Locator(model, terms.pairs)
        out = []
        for cluster in self._clusters(rows):
            states = sorted(set().union(*(self._states(r) for r in cluster)))
            for owner in dict.fromkeys(self.owner[i] for i in states):
                own = [i for i in states if self.owner[i] == owner]
                touched = [r for r in cluster if self._states(r) & set(own)]
                psi = ca.vertcat(*(self.x[i] for i in own))
                energy = ca.SX(0)
                for e in model.energies:
                    energy += e.expr if terms.members[owner] == e.owner or len(terms.members) == 1 else 0
                L = ca.vertcat(*(self.L[r][0, own] for r in touched)).T
                hessian, gradient = ca.hessian(energy, psi)
                exprs = {"L": ca.densify(L), "c": -ca.mtimes(L.T, gradient), "S": ca.mtimes([L.T, hessian, L])}
                out.append(
                    make_term("impulse", {k: ca.densify(v) for k, v in exprs.items()}, locator, "bare node",
                              rows=[("x", i) for i in own] + [("a", r) for r in touched], owner=owner,
                              extra=ca.vertsplit(psi), tag=remedy)
                )  # fmt: skip
        return out


def _depends(expr: ca.SX, on: ca.SX) -> bool:
    """Structural dependence after cancelling what differentiates to zero."""
    return ca.simplify(ca.jacobian(ca.densify(expr), on)).nnz() > 0 and ca.depends_on(expr, on)


def _state_owners(terms: Terms) -> dict[int, int]:
    """State -> the member whose energy contains it."""
    return {i: t.owner for t in terms.terms if t.kind in ("energy", "joint", "closed") for _, i in t.rows}
