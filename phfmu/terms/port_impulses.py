"""Impulses of power ports: the condition for Kirchhoff's law at step ends across members.

An impulse s (V s at an electrical port) shifts the states, x* = x + L(x) s with L = E^-1 B. With y = B^T z and S = L^T H'' L

    pair   H is quadratic along L: y* = y + S s, the work of s is s . (y + S s / 2)
    end    it is not: the work is the integral of y along L s
    none   the port does not act on states alone, or an impulse would break a hidden constraint

L must not change along the shifts, (dL/dx) L = 0, for all ports of a model together.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

import casadi as ca
import numpy as np

from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import ValueKind, time
from phfmu.terms.bare import depends
from phfmu.terms.canonical import components
from phfmu.terms.extraction.extract import extract
from phfmu.terms.hidden import HiddenConstraints
from phfmu.terms.rows import costate_symbols, costates, output_expressions, row_expressions
from phfmu.terms.term import CLOSED, CONSTRAINT, ENERGY, JOINT, MASS, MASS_BLOCK, Term, Terms, by_kind, gathered
from phfmu.terms.velocities import velocity_of


class Impulse(StrEnum):
    """Use of impulses by a port: it takes them at the start and the end of steps, without or with H bent along them, or not."""

    PAIR = "pair"
    END = "end"
    NONE = "none"


@dataclass(frozen=True)
class PortImpulse:
    """The impulses of a port: `kind` and why not more; `inputs`: places of its inputs; `linear`: its outputs are linear in x."""

    port: str
    kind: Impulse
    inputs: tuple[int, ...]
    linear: bool = False
    reason: str = ""


@dataclass(frozen=True, eq=False)
class PortForms:
    """The impulses of a model as expressions of its states x and parameters p.

    ports:   one entry per external port;  pairs: those with impulses (n), in the order of the inputs
    states:  those that the impulses move;  owner: component of each pair
    L (states x n), y (n), S (n x n)
    """

    ports: tuple[PortImpulse, ...]
    pairs: tuple[int, ...]
    states: tuple[int, ...]
    owner: tuple[int, ...]
    x: ca.SX
    p: ca.SX
    L: ca.SX
    y: ca.SX
    S: ca.SX


def port_impulses(model: PHDAE) -> PortForms:
    """The use of impulses by the external ports of a model."""
    return _PortSearch(extract(model)).forms()


class _PortSearch:
    """Search for the external ports of a model that take impulses."""

    def __init__(self, terms: Terms):
        self.terms, model = terms, terms.model
        self.z, self.u = costate_symbols(model), ca.SX.sym("u", len(terms.pairs))
        self.y = output_expressions(terms, range(terms.nu), self.z, self.u)
        self.a = ca.vertcat(*(v.sx for v in model.algebraics))
        self.owned = {r.index for t in terms.of(ENERGY, JOINT) for r in t.rows}
        self.odd = {r.index for t in terms.of(MASS_BLOCK, CLOSED) for r in t.rows}
        self.bound = constrained(terms)
        self.mass = masses(terms)

    def forms(self) -> PortForms:
        model, x = self.terms.model, self.terms.model.x
        ports, taken, states = [], [], set[int]()
        for name, pairs in self._ports():
            reason, moved = self._unfit(pairs)
            if not reason and (reason := self._disturbs([*taken, *pairs], states | moved)):
                moved = set()
            if not reason:
                taken, states = taken + pairs, states | moved
            ports.append((name, tuple(pairs), reason))
        moves = sorted(states)
        L = ca.horzcat(ca.SX(len(moves), 0), *(self._column(j)[moves] for j in taken))
        psi = x[moves] if moves else ca.SX(0, 1)
        hessian, gradient = ca.hessian(model.hamiltonian, psi) if moves else (ca.SX(0, 0), ca.SX(0, 1))
        y, S = ca.mtimes(L.T, gradient), ca.mtimes([L.T, hessian, L])
        kinds = self._kinds(S, psi)
        found = [
            PortImpulse(name, Impulse.NONE, pairs, reason=reason)
            if reason
            else _offered(name, pairs, [kinds[taken.index(j)] for j in pairs], y[[taken.index(j) for j in pairs]], x)
            for name, pairs, reason in ports
        ]
        p = ca.vertcat(ca.SX(0, 1), *(v.sx for v in model.parameters))
        owner = tuple(self.terms.pairs[j].owner for j in taken)
        return PortForms(tuple(found), tuple(taken), tuple(moves), owner, ca.vertcat(ca.SX(0, 1), x), p, L, y, S)

    def _ports(self) -> Iterator[tuple[str, list[int]]]:
        at = 0
        for port in self.terms.model.ports:
            if port.external:
                yield port.name, list(range(at, at + port.n))
                at += port.n

    def _column(self, pair: int) -> ca.SX:
        """L of one pair: all states."""
        return ca.jacobian(self.y[pair], self.z).T / self.mass

    def _unfit(self, pairs: list[int]) -> tuple[str, set[int]]:
        """Why a port takes no impulses ("": it does), and the states it moves."""
        y, names = ca.vertcat(*(self.y[j] for j in pairs)), self.terms.state_names
        slope = ca.sparsify(ca.jacobian(y, self.z))
        moved = set(slope.sparsity().get_triplet()[1])
        if ca.depends_on(y, self.u):
            return "it has feedthrough", moved
        if ca.depends_on(y, self.a):
            return "its outputs contain algebraic variables", moved
        if ca.depends_on(slope, ca.vertcat(self.z, time)):
            return "its coefficients contain costates or the time", moved
        if not moved:
            return "it acts on no state", moved
        for i in sorted(moved):
            if i in self.odd:
                return f"the row of {names[i]} has E that is no constant diagonal", moved
            if i not in self.owned:
                return f"{names[i]} stores no energy", moved
            if i in self.bound:
                return f"an impulse on {names[i]} would break the hidden constraint of {self.bound[i]}", moved
        return self._disturbs(pairs, moved), moved

    def _disturbs(self, pairs: list[int], moved: set[int]) -> str:
        """Why the coefficients do not stay as they are along the shifts."""
        L = ca.vertcat(*(self._column(j) for j in pairs))
        for i in sorted(moved):
            if depends(L, self.terms.model.x[i]):
                return f"coefficients depend on {self.terms.state_names[i]}, on which an impulse acts"
        return ""

    def _kinds(self, S: ca.SX, psi: ca.SX) -> list[Impulse]:
        """Per pair, by the pairs that S couples it with."""
        kinds: list[Impulse] = [Impulse.PAIR] * S.shape[0]
        for part in components(S + ca.SX.eye(S.shape[0])):
            if depends(S[part, part], psi):
                for i in part:
                    kinds[i] = Impulse.END
        return kinds


def _offered(name: str, pairs: tuple[int, ...], kinds: list[Impulse], y: ca.SX, x: ca.SX) -> PortImpulse:
    slope = ca.simplify(ca.jacobian(y, x))
    linear = not depends(slope, x) if slope.nnz() else True
    if Impulse.END in kinds:
        return PortImpulse(name, Impulse.END, pairs, linear, "the stored energy is not quadratic along its impulses")
    return PortImpulse(name, Impulse.PAIR, pairs, linear)


def masses(terms: Terms) -> ca.SX:
    """The diagonal of E (n1), 1 where it is none."""
    out, p = ca.SX.ones(terms.n1), ca.vertcat(*(v.sx for v in terms.model.parameters))
    for t in terms.of(MASS):
        local, m = t.symbols(ValueKind.PARAMETER), t.data["m"]
        at = t.rows[0].index
        out[at] = ca.substitute([m], [local], [p[list(t.index[ValueKind.PARAMETER])]])[0] if local.numel() else m
    return out


def mass_values(terms: Terms, masses: Iterable[Term]) -> dict[int, float]:
    """State -> its mass at the start values of the parameters, of some mass terms."""
    masses = list(masses)
    p, found = np.array([s for v in terms.model.parameters for s in v.start], float), dict[int, float]()
    for own in by_kind(masses):
        f = ca.Function("m", [own[0].symbols(ValueKind.PARAMETER)], [ca.densify(own[0].data["m"])])
        values = np.array(f(gathered(p, own, ValueKind.PARAMETER))).ravel()
        found |= {t.rows[0].index: m for t, m in zip(own, values.tolist(), strict=True)}
    return {i: found[i] for i in (t.rows[0].index for t in masses)}


def constrained(terms: Terms) -> dict[int, str]:
    """State -> hidden constraint that an impulse on it would break."""
    names = terms.algebraic_names
    holonomic = {t.rows[0].index: t for t in terms.of(CONSTRAINT)}
    out, velocity = {}, velocity_of(terms)
    for row, t in holonomic.items():
        for q in t.indices(ValueKind.STATE):
            out |= {q: names[row], velocity[q]: names[row]}
    rows = sorted(terms.found(HiddenConstraints).rows - holonomic.keys())
    if rows:
        z = costates(terms)
        for row, c in row_expressions(terms, rows, z).items():
            found = ca.which_depends(c, terms.model.x, 1)
            out |= {i: names[row] for i, d in enumerate(found) if d}
    return out
