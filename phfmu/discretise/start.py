"""Consistent starts: project a start onto its hidden constraints, positions first, then velocities and currents.

Positions:   min sum ((q - q0)/nominal)^2            s.t.  g(q, t) = 0
Velocities:  min 1/2 (x - x0)^T H''(x0) (x - x0)     s.t.  c(x) = 0   (Dg v + g_t = 0, sums of currents, rigid joints)

The second is what an impulse of the constraint forces or node voltages does: x - x0 = B s, momentum is kept, and
energy is lost as in an inelastic impact.  States named as kept do not move.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.variable import time
from phfmu.discretise.extract import extract
from phfmu.discretise.model import CONSISTENCY, Model
from phfmu.discretise.rank import TOLERANCE
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


def project_start(
    model: Model, x: Array | None = None, *, p: Array | None = None, t: float | None = None, keep: Iterable[str] = ()
) -> Projection:
    """Project x at parameters p and time t (defaults: the start values) onto the constraints of `model`.

    keep: states that stay as they are, by scalar name or the bare name of a vector.
    DeclarationError names the equations that cannot be met, with their residuals, or an unknown state.
    """
    start = model.x0 if x is None else np.asarray(x, float)
    names = [n for v in model.declaration.states for n in v.names()]
    free = ~_kept(model, names, list(keep))
    rows = _Rows(model, model.p0 if p is None else np.asarray(p, float), model.t0 if t is None else t)
    level = np.array([c.level for c in model.checks])
    positions = np.abs(rows.jacobian(start)[level == "position"]).sum(axis=0) > 0
    nominal = np.array([v.nominal[j] for v in model.declaration.states for j in range(v.n)])
    now = _newton(rows, start, level == "position", free & positions, np.diag(1 / nominal**2))
    _require(rows, now, level == "position", free & positions, names)
    hessian = rows.hessian(now)
    without = np.where(np.diag(hessian) == 0.0, 1 / nominal**2, 0.0)  # states that store no energy
    now = _newton(rows, now, level == "velocity", free & ~positions, hessian + np.diag(without))
    _require(rows, now, level == "velocity", free & ~positions, names)
    moved = [
        (n, float(a), float(b)) for n, a, b in zip(names, start, now, strict=True) if abs(a - b) > 1e-15 * (1 + abs(a))
    ]
    first, last = (map(float, rows.values(v)) for v in (start, now))
    return Projection(
        now, tuple(moved), dict(zip(rows.labels, first, strict=True)), dict(zip(rows.labels, last, strict=True)),
        rows.energy(now) - rows.energy(start),
    )  # fmt: skip


def _kept(model: Model, names: list[str], keep: list[str]) -> NDArray[np.bool_]:
    kept = np.zeros(len(names), bool)
    for name in keep:
        found = [i for i, n in enumerate(names) if n == name or n.partition("[")[0] == name]
        if not found:
            bare = list(dict.fromkeys(n.partition("[")[0] for n in names))
            close = get_close_matches(name, [*names, *bare], 5)
            raise DeclarationError(
                f"{model.name} has no state {name}; {'close' if close else 'states'}: {', '.join(close or bare)}"
            )
        kept[found] = True
    return kept


class _Rows:
    """The hidden constraints of a model as functions of the state."""

    def __init__(self, model: Model, p: Array, t: float):
        d = model.declaration
        rows = ca.vertcat(*check_rows(extract(d), list(model.checks))) if model.checks else ca.SX(0, 1)
        symbols = [d.x, ca.vertcat(*(p.sx for p in d.parameters)), time]
        hessian = ca.hessian(d.hamiltonian, d.x)[0]
        exprs = (rows, ca.jacobian(rows, d.x), d.hamiltonian, hessian)
        self._functions = [ca.Function("f", symbols, [e]) for e in exprs]
        self._fixed = (p, t)
        self.labels = [f"{c.name} ({c.level})" for c in model.checks]
        self.names = [c.name for c in model.checks]
        self.size, self.model = model.check_scale, model.name

    def _at(self, i: int, x: Array) -> Array:
        return self._functions[i](x, *self._fixed).full()

    def values(self, x: Array) -> Array:
        return self._at(0, x).ravel()

    def jacobian(self, x: Array) -> Array:
        return self._at(1, x)

    def energy(self, x: Array) -> float:
        return float(self._at(2, x)[0, 0])

    def hessian(self, x: Array) -> Array:
        return self._at(3, x)


def _newton(f: _Rows, x: Array, rows: Array, free: Array, metric: Array) -> Array:
    """Least changes of the `free` states in `metric` until the chosen constraints hold, or no longer improve."""
    if not rows.any() or not free.any():
        return x
    inverse = np.linalg.pinv(metric[np.ix_(free, free)])
    for _ in range(ITERATIONS):
        c, jac = f.values(x)[rows], f.jacobian(x)[np.ix_(rows, free)]
        if np.all(np.abs(c) <= 1e-6 * CONSISTENCY * f.size[rows]):
            break
        step = np.zeros(len(x))
        step[free] = -inverse @ jac.T @ np.linalg.pinv(jac @ inverse @ jac.T, rcond=TOLERANCE, hermitian=True) @ c
        if not np.isfinite(step).all():
            break
        x = x + step
    return x


def _require(f: _Rows, x: Array, rows: Array, free: Array, names: list[str]) -> None:
    """DeclarationError with the equations of `rows` that do not hold at x, and why where that is clear."""
    values = f.values(x)
    bad = [i for i in np.flatnonzero(rows) if not abs(values[i]) <= CONSISTENCY * f.size[i]]
    if not bad:
        return
    left = ", ".join(f"{f.labels[i]} residual {values[i]:.6g} (tolerance {CONSISTENCY * f.size[i]:.3g})" for i in bad)
    jac = f.jacobian(x)
    remedy = _contradiction(f, jac, values, rows, free)
    if not remedy:
        touched = {j for i in bad for j in np.flatnonzero(jac[i]) if not free[j]}
        held = [names[j] for j in sorted(touched)]
        remedy = f"Keep fewer of {', '.join(held[:12])}, or start nearer" if held else "Start nearer"
    raise DeclarationError(f"{f.model}: no consistent start near the given one; left over: {left}. {remedy}")


def _contradiction(f: _Rows, jac: Array, values: Array, rows: Array, free: Array) -> str:
    """Rows whose gradients depend on each other while their values do not, "" if there are none."""
    chosen = np.flatnonzero(rows)
    matrix = jac[np.ix_(chosen, free)]
    size = np.linalg.norm(matrix, axis=1, keepdims=True)
    left, s, _ = np.linalg.svd(matrix / np.where(size > 0, size, 1.0))
    null = left[:, int(np.sum(s > TOLERANCE)) :] / np.where(size > 0, size, 1.0)
    gaps = np.abs(null.T @ values[chosen])
    if not gaps.size:
        return ""
    y = null[:, int(np.argmax(gaps))]
    in_it = [int(i) for i in np.flatnonzero(np.abs(y) > 1e-6 * np.abs(y).max())]
    gap = abs(y @ values[chosen]) / np.abs(y).max()
    if gap <= CONSISTENCY * min(f.size[chosen[i]] for i in in_it) or len(in_it) < 2:
        return ""
    *others, last = (f.names[chosen[i]] for i in in_it)
    return f"{last} contradicts {', '.join(others)} by {gap:.3g}: they depend on each other; correct one of them or leave it out"
