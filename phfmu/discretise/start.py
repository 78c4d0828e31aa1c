"""Consistent starts: project a start onto its hidden constraints, positions first, then velocities and currents.

Positions:   min sum ((q - q0)/nominal)^2            s.t.  g(q) = 0
Velocities:  min 1/2 (x - x0)^T H''(x0) (x - x0)     s.t.  c(x) = 0   (Dg v = 0, sums of currents, rigid joints)

The second is what an impulse of the constraint forces or node voltages does: x - x0 = B s, momentum is kept, and
energy is lost as in an inelastic impact.  States named as kept do not move.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.variable import time
from phfmu.discretise.extract import extract
from phfmu.discretise.model import CONSISTENCY, Model
from phfmu.discretise.rows import check_rows
from phfmu.discretise.terms import DeclarationError

Array = NDArray[Any]

ITERATIONS = 30


@dataclass(frozen=True)
class Projection:
    """The consistent state, what moved (name, before, after), the constraints before and after, the energy change [J]."""

    x: Array
    moved: tuple[tuple[str, float, float], ...]
    before: dict[str, float]
    after: dict[str, float]
    energy: float

    def report(self) -> str:
        """A line per constraint and per state that moved."""
        lines = [f"{n}: {v:.6g} -> {self.after[n]:.2g}" for n, v in self.before.items()]
        lines += [f"{n}: {a:.9g} -> {b:.9g}" for n, a, b in self.moved]
        return "\n".join([*lines, f"energy changed by {self.energy:.9g} J"])


def project_start(model: Model, x: Array | None = None, *, keep: Iterable[str] = ()) -> Projection:
    """Project x (default: the start) onto the constraints of `model`, leaving the states named in `keep` as they are.

    DeclarationError if the kept states leave no consistent state nearby, or a name is unknown.
    """
    start = model.x0 if x is None else np.asarray(x, float)
    d = model.declaration
    names = [n for v in d.states for n in v.names()]
    unknown = set(keep) - set(names)
    if unknown:
        raise DeclarationError(
            f"{model.name} has no state {', '.join(sorted(unknown))}; states: {', '.join(names[:12])}"
        )
    free = np.array([n not in set(keep) for n in names])
    f = _functions(model)
    level = np.array([c.level for c in model.checks])
    positions = np.abs(np.array(f(start, model.p0, model.t0)[1])[level == "position"]).sum(axis=0) > 0
    nominal = np.array([v.nominal[j] for v in d.states for j in range(v.n)])
    now = _newton(f, model, start, level == "position", free & positions, np.diag(1 / nominal**2))
    hessian = np.array(f(now, model.p0, model.t0)[3])
    without = np.where(np.diag(hessian) == 0.0, 1 / nominal**2, 0.0)  # states that store no energy
    now = _newton(f, model, now, level == "velocity", free & ~positions, hessian + np.diag(without))
    labels = [f"{c.name} ({c.level})" for c in model.checks]
    first, last = (np.array(f(v, model.p0, model.t0)[0]).ravel() for v in (start, now))
    bad = [n for n, v, s in zip(labels, last, model.check_scale, strict=True) if not abs(v) <= CONSISTENCY * s]
    if bad:
        raise DeclarationError(
            f"{model.name}: no consistent start near the given one; left over: {', '.join(bad)}. Keep fewer states or "
            "start nearer"
        )
    moved = [
        (n, float(a), float(b)) for n, a, b in zip(names, start, now, strict=True) if abs(a - b) > 1e-15 * (1 + abs(a))
    ]
    energy = float(f(now, model.p0, model.t0)[2]) - float(f(start, model.p0, model.t0)[2])
    return Projection(
        now, tuple(moved), dict(zip(labels, map(float, first), strict=True)),
        dict(zip(labels, map(float, last), strict=True)), energy,
    )  # fmt: skip


def _functions(model: Model) -> ca.Function:
    """(x, p) -> constraints, their Jacobian, H, Hessian of H."""
    d = model.declaration
    rows = ca.vertcat(*check_rows(extract(d), list(model.checks))) if model.checks else ca.SX(0, 1)
    parameters = ca.vertcat(*(p.sx for p in d.parameters))
    hessian = ca.hessian(d.hamiltonian, d.x)[0]
    return ca.Function("c", [d.x, parameters, time], [rows, ca.densify(ca.jacobian(rows, d.x)), d.hamiltonian, hessian])


def _newton(f: ca.Function, model: Model, x: Array, rows: Array, free: Array, metric: Array) -> Array:
    """Least changes of the `free` states in `metric` until the chosen constraints hold."""
    if not rows.any() or not free.any():
        return x
    inverse = np.linalg.pinv(metric[np.ix_(free, free)])
    for _ in range(ITERATIONS):
        c, jac = (np.array(v) for v in f(x, model.p0, model.t0)[:2])
        c, jac = c.ravel()[rows], jac[np.ix_(rows, free)]
        if np.all(np.abs(c) <= 1e-6 * CONSISTENCY * model.check_scale[rows]):
            break
        step = np.zeros(len(x))
        step[free] = -inverse @ jac.T @ np.linalg.pinv(jac @ inverse @ jac.T) @ c
        x = x + step
    return x
