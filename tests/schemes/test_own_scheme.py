"""A scheme with unknowns of its own, written here and nowhere else: the package knows it by its protocol only.

Midpoint collocation keeps g(q) of a holonomic model, its velocities come off the constraint.  At the end of each step an
impulse puts them back, what that costs is a numerical loss:

    v' = v* + s,   s = Dg(q')^T mu,   Dg(q') v' = 0,   loss = -(H(v') - H(v*)) = -s^T (v* + s/2)        (M = 1)
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

from phfmu import (
    PHDAE,
    Collocated,
    Holonomic,
    NativeInstance,
    PythonInstance,
    algebraic,
    build_model,
    energy,
    skew,
    state,
)
from phfmu.gradients.quadrature import Nodes, nodes
from phfmu.plan.address import Address, increment, velocity_increment, with_velocities
from phfmu.plan.arguments import Arguments
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Holds
from phfmu.plan.planner import Maps
from phfmu.plan.spec import Result, Spec
from phfmu.plan.unknown import Role, Unknown, of_algebraics, of_states
from phfmu.schemes.scheme import Scheme, Triplet
from phfmu.terms.term import CONSTRAINT, Term, Terms

KICK = Role("impulse of a constraint at the end of a step", vanishes=True)
SHIFT = Role("shift of a velocity by impulses", vanishes=True)


def kick(layout: Layout, term: Term, j: int, node: int) -> int:
    del j, node
    return layout.at(KICK, term.rows[0][1])


def shift(layout: Layout, term: Term, j: int, node: int) -> int:
    return layout.at(SHIFT, layout.terms.velocity_of[term.index["x"][j]], node)


@dataclass(frozen=True)
class Kicked:
    """Midpoint collocation with impulses that keep Dg v = 0; unit masses."""

    name: str = "kicked"
    gradient: str = "per-term"
    order: int = 2
    joint: bool = field(default=False, init=False)
    loses_energy: bool = field(default=True, init=False)
    two_level: bool = field(default=True, init=False)
    impulses: bool = field(default=False, init=False)

    @property
    def _base(self) -> Collocated:
        return Collocated(1, self.gradient, impulses=False)

    @property
    def nodes(self) -> Nodes:
        return nodes(1)

    def prepare(self, terms: Terms) -> Terms:
        return self._base.prepare(terms)

    def unknowns(self, terms: Terms) -> Sequence[Unknown]:
        bars = terms.of(CONSTRAINT)
        velocities = sorted({terms.velocity_of[q] for t in bars for q in t.index["x"]})
        out = self._base.unknowns(terms)
        out += of_algebraics(terms, KICK, "velocity at the end on", [t.rows[0][1] for t in bars])
        return out + of_states(terms, SHIFT, "impulse on", velocities)

    def reports(self, terms: Terms) -> Sequence[Hashable]:
        return self._base.reports(terms)

    def specs(self, term: Term) -> list[Spec]:
        found = self._base.specs(term)
        return [*found, _impulse(term)] if term.kind is CONSTRAINT else found

    def constants(self, layout: Layout) -> list[Triplet]:
        own = [w for w, u in enumerate(layout.unknowns) if u.role is SHIFT]
        return self._base.constants(layout) + [(w, w, 1.0, 0) for w in own]

    def maps(self, layout: Layout) -> Maps:
        base = self._base.maps(layout)
        shifts = [(u.index, w, 1.0) for w, u in enumerate(layout.unknowns) if u.role is SHIFT]
        return replace(base, update=base.update + shifts)

    def holds(self, layout: Layout) -> Holds:
        del layout
        return Holds()


def _impulse(term: Term) -> Spec:
    args, q, g = Arguments(term, 1), term.local["x"], term.data["g"]
    n = q.numel()
    v = ca.SX.sym("v", n)
    d, dv, s, mu = (
        args.matrix(increment, n),
        args.matrix(velocity_increment, n),
        args.matrix(shift, n),
        args.symbol(kick),
    )
    end = ca.substitute(ca.gradient(g, q), q, q + d)
    out: list[Result] = [(Address(shift, j), 0, -end[j] * mu) for j in range(n)]
    out.append((Address(kick), 0, ca.dot(end, v + dv + s)))
    stored = mu * ca.dot(end, v + dv + s / 2)
    return Spec(1, ca.vertcat(q, v), args.p, args.y, out, stored=stored, numerical=-stored, old=with_velocities)


GRAVITY = 9.81
START = np.array([0.6, -0.8, 0.8, 0.6])  # on the unit circle, velocity along it


@pytest.fixture(scope="module")
def pendulum() -> PHDAE:
    q, v = state("q", 2, start=START[:2]), state("v", 2, start=START[2:])
    lam = algebraic("lambda")
    return PHDAE(
        "pendulum", states=(q, v), algebraics=(lam,), structure=(skew(q, v, 1.0),),
        energies=(energy(ca.sumsqr(v.sx) / 2), energy(GRAVITY * q.sx[1])),
        constraints=(Holonomic(lam, (ca.sumsqr(q.sx) - 1) / 2),),
    )  # fmt: skip


def by_hand(x: np.ndarray, h: float) -> np.ndarray:
    """One step from its equations, without the package."""

    def residual(w: np.ndarray) -> np.ndarray:
        q1, v1, lam, mu = w[:2], w[2:4], w[4], w[5]
        middle, force = (x[:2] + q1) / 2, np.array([0.0, -GRAVITY])
        star = x[2:] + h * (force - middle * lam)  # v*
        return np.concatenate([q1 - x[:2] - h * (x[2:] + star) / 2, v1 - star - q1 * mu, [(q1 @ q1 - 1) / 2, q1 @ v1]])

    return root(residual, np.concatenate([x, [10.0, 0.0]]), tol=1e-13).x[:4]


@pytest.mark.parametrize("engine", [PythonInstance, NativeInstance])
def test_a_scheme_with_unknowns_of_its_own_runs_in_both_engines(pendulum: PHDAE, engine: type) -> None:
    """Its steps are those of the equations solved by hand; both constraints hold, the ledger closes with its loss."""
    scheme: Scheme = Kicked()
    model = build_model(pendulum, scheme)
    assert model.step.nw == 5 + 1 + 2 and model.loses_energy and "impulse on v[1]" in model.row_names
    instance, x, h, lost = engine(model), START, 0.02, 0.0
    for k in range(40):
        instance.do_step(k * h, h)
        x = by_hand(x, h)
        assert instance.x == pytest.approx(x, abs=1e-10)
        now = instance.x
        assert abs(now[:2] @ now[:2] - 1) <= 1e-13 * (k + 1) and abs(now[:2] @ now[2:]) <= 1e-12
        row = instance.ledger()
        balance = np.sum(row["stored"] + row["dissipated"] + row["numerical"] - row["supplied"])
        assert abs(balance) <= 1e-12
        lost += float(np.sum(row["numerical"]))
    energies = [y[2:] @ y[2:] / 2 + GRAVITY * y[1] for y in (START, instance.x)]
    assert lost == pytest.approx(energies[0] - energies[1], abs=1e-11) and abs(lost) > 1e-9


def test_it_converges_with_its_order(pendulum: PHDAE) -> None:
    """Against the angle of the pendulum by another method."""
    model, stop = build_model(pendulum, Kicked()), 0.4
    start = [np.arctan2(START[0], -START[1]), START[2] * -START[1] + START[3] * START[0]]
    found = solve_ivp(lambda t, y: [y[1], -GRAVITY * np.sin(y[0])], (0, stop), start, rtol=1e-12, atol=1e-12)
    angle = found.y[0, -1]
    exact, errors = np.array([np.sin(angle), -np.cos(angle)]), []
    for n in (20, 40, 80):
        instance = PythonInstance(model)
        for k in range(n):
            instance.do_step(k * stop / n, stop / n)
        errors.append(float(np.max(np.abs(instance.x[:2] - exact))))
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(2.0, abs=0.1)
