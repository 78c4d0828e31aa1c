"""Bare nodes: algebraic rows that join inductive branches only, and their remedies in a step.

The row of such a node, c(x) = -L(x)^T z = 0, contains no algebraic variable (index 2); v acts on the states by x' = L v.

    pair         neutral impulses at both ends of the step (`impulses.py`): needs (dL/dx) L = 0, (dS/dx) L = 0, S = L^T H'' L
    projection   one impulse at the end of the step, whose loss is booked: needs (dL/dx) L = 0
    none         neither fits; the node is met by the nodes of the scheme only
"""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, partial

import casadi as ca
import numpy as np

from phfmu.declare.variable import ValueKind
from phfmu.terms.canonical import Locator, components, make_term, scalars
from phfmu.terms.hidden import HiddenConstraints
from phfmu.terms.located import ResidualRow, RowAt
from phfmu.terms.rows import costate_symbols, costates, row_expressions
from phfmu.terms.term import CLOSED, CONSTRAINT, ENERGY, JOINT, Term, TermKind, Terms


class Remedy(StrEnum):
    """Remedies for a bare node at the ends of steps."""

    PAIR = "pair"  # neutral impulse pair: exact
    PROJECTION = "projection"  # onto the sum of currents, loss booked
    NONE = "none"


#: smallest over largest eigenvalue of an inductance matrix that counts as singular
SINGULAR = 1e-12
#: the impulses of a bare node on the states of a member
IMPULSE = TermKind("impulse")


@dataclass(frozen=True)
class BareNode:
    """A bare algebraic row, its remedy, and the reason why it has no better one (empty for a pair)."""

    row: int
    name: str
    remedy: Remedy
    reason: str = ""


def remedy(linear: bool, unfit: str, S: Callable[[], np.ndarray], bent: Callable[[], str]) -> tuple[Remedy, str] | None:
    """The remedy for rows that S couples, composed or of members stepped apart, and why none is better; None: it needs none.

    linear: all rows are linear in the state and stay at their start;  unfit: why no impulse may act;  S: inductance matrix;
    bent: why H is not quadratic along the impulses.  The last two are asked for where they matter.
    """
    if linear:
        return None
    if unfit:
        return Remedy.NONE, unfit
    values = np.linalg.eigvalsh(S())
    if not values[0] > SINGULAR * values[-1]:
        return Remedy.NONE, "its inductance matrix is singular (isolated neutral)"
    reason = bent()
    return (Remedy.PROJECTION, reason) if reason else (Remedy.PAIR, "")


def bare_nodes(terms: Terms) -> list[BareNode]:
    """Rows of nodes that join inductive branches only and whose currents depend on the state nonlinearly.

    A row that is linear in the state (constant L, quadratic H) stays at its start value and needs nothing.
    """
    return BareRows(terms).nodes


class BareRows:
    """Symbolic form of the bare rows of a model."""

    def __init__(self, terms: Terms):
        self.terms, self.nodes = terms, []
        holonomic = {t.rows[0].index for t in terms.of(CONSTRAINT)}
        rows = [r for r in terms.found(HiddenConstraints).checks if r not in holonomic]
        if not rows:
            return
        model = terms.model
        self.x, self.z = model.x, costate_symbols(model)
        self.expr = self._without_zeros(row_expressions(terms, rows, self.z))
        self.L = {r: -self._by_costates(self.expr[r]) for r in rows}
        self.place = {r: i for i, r in enumerate(rows)}
        L = ca.vertcat(*self.L.values())
        self.S = ca.mtimes([L, ca.hessian(model.hamiltonian, self.x)[0], L.T])
        self.states = {r: set(self.L[r].sparsity().get_triplet()[1]) for r in rows}
        self.owner = {r.index: t.owner for t in terms.of(ENERGY, JOINT, CLOSED) for r in t.rows}
        linear = self._linear(L, rows)
        names = [n for v in model.algebraics for n in v.names()]
        for cluster in self._clusters(rows):
            at, psi = [self.place[r] for r in cluster], ca.vertcat(*(self.x[i] for i in self._states(cluster)))
            S = self.S[at, at]
            bent = partial(self._bent, S, psi)
            found = remedy(linear.issuperset(cluster), self._unfit(cluster), partial(self._at_start, S), bent)
            if found is not None:
                self.nodes += [BareNode(r, names[r], *found) for r in cluster]

    def _by_costates(self, expr: ca.SX) -> ca.SX:
        """d expr / dz (1 x n1), by those costates only that stand in the expression."""
        read = [s for s in ca.symvar(expr) if s.element_hash() in self._costates]
        if not read:
            return ca.SX(1, self.terms.n1)
        slope = ca.jacobian(expr, ca.vertcat(*read))
        columns = [self._costates[read[j].element_hash()] for j in slope.sparsity().get_triplet()[1]]
        return ca.SX.triplet([0] * len(columns), columns, ca.vec(slope.nz[:]), 1, self.terms.n1)

    def _without_zeros(self, rows: dict[int, ca.SX]) -> dict[int, ca.SX]:
        """The rows without algebraic variables that a row of their own makes zero: the current of an ideal meter."""
        algebraics = {s.element_hash(): s for v in self.terms.model.algebraics for s in ca.vertsplit(v.sx)}
        inside = {s.element_hash() for expr in rows.values() for s in ca.symvar(expr)} & set(algebraics)
        if not inside:
            return rows
        u = ca.SX.sym("u", len(self.terms.pairs))  # what a source gives is not zero
        others = row_expressions(self.terms, [r for r in range(len(algebraics)) if r not in rows], self.z, u)
        zero = []
        for expr in others.values():
            alone = ca.symvar(expr)
            if len(alone) == 1 and alone[0].element_hash() in inside:
                slope, rest = ca.jacobian(expr, alone[0]), ca.substitute(expr, alone[0], 0)
                if slope.is_constant() and float(slope) and ca.simplify(rest).is_zero():
                    zero.append(alone[0])
        if not zero:
            return rows
        symbols = ca.vertcat(*zero)
        return {
            r: ca.simplify(ca.substitute(expr, symbols, ca.SX.zeros(symbols.numel(), 1))) for r, expr in rows.items()
        }

    def _linear(self, L: ca.SX, rows: list[int]) -> set[int]:
        """Rows whose c is linear in the state."""
        slope = ca.simplify(ca.jacobian(ca.mtimes(L, costates(self.terms)), self.x))
        row_of = slope.sparsity().get_triplet()[0]
        varying = ca.jacobian_sparsity(ca.vertcat(ca.SX(0, 1), *scalars(slope)), self.x).get_triplet()[0]
        return set(rows) - {rows[row_of[i]] for i in varying}

    def _clusters(self, rows: list[int]) -> list[list[int]]:
        """Rows that S = L^T H'' L couples: they share branches or mutual inductances."""
        at = [self.place[r] for r in rows]
        return [[rows[i] for i in part] for part in components(self.S[at, at] + ca.SX.eye(len(rows)))]

    def _states(self, cluster: list[int]) -> list[int]:
        return sorted(set().union(*(self.states[r] for r in cluster)))

    def _unfit(self, cluster: list[int]) -> str:
        """Why no impulse may act at these rows ("": some may)."""
        states = self._states(cluster)
        for i in states:
            if i in self._special:
                return f"the row of {self._state_names[i]} has E other than identity"
            if i not in self.owner:
                return f"{self._state_names[i]} stores no energy"
        psi = ca.vertcat(*(self.x[i] for i in states))
        for r in cluster:
            if self._reads(self.expr[r], self._algebraics) or self._reads(self.L[r], self._costates):
                return f"the row of {self._nodes[r]} contains other algebraic variables"
            if depends(self.L[r], psi):
                return f"the coefficients of {self._nodes[r]} depend on the states they act on"
        return ""

    @staticmethod
    def _reads(expr: ca.SX, some: Container[int]) -> bool:
        """True if one of `some` symbols, by their hashes, stands in an expression."""
        return any(s.element_hash() in some for s in ca.symvar(expr))

    @cached_property
    def _algebraics(self) -> frozenset[int]:
        return frozenset(s.element_hash() for v in self.terms.model.algebraics for s in ca.vertsplit(v.sx))

    @cached_property
    def _costates(self) -> dict[int, int]:
        return {s.element_hash(): i for i, s in enumerate(ca.vertsplit(self.z))}

    @cached_property
    def _state_names(self) -> list[str]:
        return [n for v in self.terms.model.states for n in v.names()]

    @cached_property
    def _nodes(self) -> list[str]:
        return [n for v in self.terms.model.algebraics for n in v.names()]

    def _bent(self, S: ca.SX, psi: ca.SX) -> str:
        return (
            "the stored energy is not quadratic in the states of its branches (saturation)" if depends(S, psi) else ""
        )

    @cached_property
    def _special(self) -> set[int]:
        return self.terms.with_descriptor()

    @cached_property
    def _locator(self) -> Locator:
        return Locator(self.terms.model, self.terms.pairs)

    @cached_property
    def _starts(self) -> dict[ValueKind, list[float]]:
        model = self.terms.model
        of = {ValueKind.STATE: model.states, ValueKind.PARAMETER: model.parameters}
        return {kind: [x for v in variables for x in v.start] for kind, variables in of.items()}

    def _at_start(self, expr: ca.SX) -> np.ndarray:
        symbols = ca.symvar(expr)
        places = [self._locator.find(s, "bare node") for s in symbols]
        values = [self._starts[at.kind][at.index] for at in places]
        return np.array(ca.Function("S", symbols, [ca.densify(expr)])(*values))

    def impulse_terms(self, remedy: Remedy) -> list[Term]:
        """One term per member and cluster with this remedy: L, its part c of the rows, and S, in the member's states."""
        rows = [n.row for n in self.nodes if n.remedy == remedy]
        if not rows:
            return []
        locator, energies = self._locator, self._energies()
        out = []
        for cluster in self._clusters(rows):
            states = self._states(cluster)
            for owner in dict.fromkeys(self.owner[i] for i in states):
                own = [i for i in states if self.owner[i] == owner]
                touched = [r for r in cluster if not self.states[r].isdisjoint(own)]
                psi = ca.vertcat(*(self.x[i] for i in own))
                L = ca.vertcat(*(self.L[r][0, own] for r in touched)).T
                hessian, gradient = ca.hessian(energies[owner], psi)
                exprs = {"L": L, "c": -ca.mtimes(L.T, gradient), "S": ca.mtimes([L.T, hessian, L])}
                rows = [
                    *(RowAt(ResidualRow.BALANCE, i) for i in own),
                    *(RowAt(ResidualRow.EQUATION, r) for r in touched),
                ]
                dense = {k: ca.densify(v) for k, v in exprs.items()}
                out.append(
                    make_term(
                        IMPULSE,
                        dense,
                        locator,
                        "bare node",
                        rows=rows,
                        owner=owner,
                        extra=ca.vertsplit(psi),
                        form=remedy,
                    )
                )
        return out

    def _energies(self) -> dict[int, ca.SX]:
        """H of every member."""
        members = {name: i for i, name in enumerate(self.terms.members)}
        out: dict[int, ca.SX] = {}
        for e in self.terms.model.energies:
            owner = members.get(e.owner, 0)
            out[owner] = out.get(owner, ca.SX(0)) + e.expr
        return out


def depends(expr: ca.SX, on: ca.SX) -> bool:
    """Structural dependence after cancelling expressions that differentiate to zero."""
    entries = ca.vec(expr.nz[:])
    return ca.simplify(ca.jacobian(entries, on)).nnz() > 0 and ca.depends_on(entries, on)
