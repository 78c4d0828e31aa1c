"""Consistent starts: project a start onto its hidden constraints, positions first, then velocities and currents.

Positions:   min sum ((q - q0)/nominal)^2      s.t.  g(q, t) = 0
Velocities:  x = x0 + L s,  L = E^-1 A         s.t.  c(x) = A^T z + c0 = 0   (Dg v + g_t = 0, sums of currents, rigid joints)

The second is an impulse s of the constraint forces or node voltages: momentum is kept, and energy is lost as in an inelastic
impact.  Its columns are those of the costates in c, so no angle moves in which c has coefficients.  It is the least change in
H''; with states that are kept, the least of the others.  Rows that share no such state, directly or through H'', are projected
apart from each other, and those that hold not at all: whatever a violated row does not touch keeps its bits.

The energy of the impulse is int (grad H)^T dx along it, by component, and no difference of H, in which it would be lost beside
what a rotor stores.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, csr_matrix
from scipy.sparse.csgraph import connected_components

from phfmu.declare.error import DeclarationError
from phfmu.declare.variable import time
from phfmu.discretise.model import CONSISTENCY, Model
from phfmu.terms.extraction.extract import extract
from phfmu.terms.extraction.extract_energy import component_energies
from phfmu.terms.hidden import Level
from phfmu.terms.rank import TOLERANCE
from phfmu.terms.reach import moved_by_impulses
from phfmu.terms.rows import check_rows, costate_symbols, costates

Array = NDArray[Any]

ITERATIONS = 30


@dataclass(frozen=True)
class Projection:
    """The consistent state, every state that moved (name, before, after), the constraints before and after, energy change [J].

    `violated`: the constraints that were off by more than a start may be;  `changes`: energy by component, where one model
    was moved;  `lost`: of `energy` what impulses lost.
    """

    x: Array
    moved: tuple[tuple[str, float, float], ...]
    before: dict[str, float]
    after: dict[str, float]
    energy: float
    violated: tuple[str, ...] = ()
    changes: tuple[float, ...] = ()
    lost: float = 0.0

    def moves(self) -> list[str]:
        """`name: before -> after` for every state that moved."""
        return [_move(n, a, b) for n, a, b in self.moved]

    def report(self) -> str:
        """A line per constraint and per state that moved."""
        lines = [f"{n}: {v:.6g} -> {self.after[n]:.2g}" for n, v in self.before.items()]
        return "\n".join([*lines, *self.moves(), f"energy changed by {self.energy:.9g} J"])


def _move(name: str, before: float, after: float) -> str:
    """The change of a state as text, with as many digits as tell the two values apart."""
    pairs = ((f"{before:.{digits}g}", f"{after:.{digits}g}") for digits in (9, 13, 17))
    a, b = next((a, b) for a, b in pairs if a != b)
    return f"{name}: {a} -> {b}"


def project_start(
    model: Model, x: Array | None = None, *, p: Array | None = None, t: float | None = None, keep: Iterable[str] = ()
) -> Projection:
    """Project x at parameters p and time t (defaults: the start values) onto the constraints of `model`.

    keep: states that stay as they are, by scalar name or the bare name of a vector.
    DeclarationError names the equations that cannot be met, with their residuals, or an unknown state.
    """
    start = model.x0 if x is None else np.asarray(x, float)
    names = [n for v in model.declaration.states for n in v.names()]
    kept = _kept(model, names, list(keep))
    rows = _Constraints(model, model.p0 if p is None else np.asarray(p, float), model.t0 if t is None else t)
    places, velocities = _levels(model, rows, kept)
    first = rows.values(start)
    placed = _placed(rows, start, places, kept, names)
    now = _placed(rows, placed, velocities, kept, names)
    moved = [(n, float(a), float(b)) for n, a, b in zip(names, start, now, strict=True) if a != b]
    last, impulse = rows.values(now), rows.work(placed, now)
    changes = rows.energies(placed) - rows.energies(start) + impulse
    off = tuple(n for n, c, s in zip(rows.labels, first, rows.size, strict=True) if not abs(c) <= CONSISTENCY * s)
    return Projection(
        now, tuple(moved), dict(zip(rows.labels, map(float, first), strict=True)),
        dict(zip(rows.labels, map(float, last), strict=True)), float(changes.sum()), off, tuple(map(float, changes)),
        -float(impulse.sum()),
    )  # fmt: skip


def start_tangents(model: Model, x: Array, p: Array, t: float, dx: Array, dp: Array) -> Array:
    """Tangents (nx x n) of the projection of a consistent start x, along dx of the states and dp (np x n) of the parameters."""
    rows = _Constraints(model, p, t)
    along, slope, by_parameters = np.array(dx, float), rows.jacobian(x), rows.by_parameters(x) @ dp
    for level in _levels(model, rows, np.zeros(len(x), bool)):
        if not level.rows.any() or not level.free.any():
            continue
        metric = rows.hessian(x) if level.energetic else np.diag(level.scale**-2)
        gradient = rows.forces(x) if level.energetic else slope
        for own, states in level.parts(rows):
            off = slope[own] @ along + by_parameters[own]
            for column in np.flatnonzero(off.any(axis=0)):
                among = metric[np.ix_(states, states)]
                along[states, column] += _least(
                    among, gradient[np.ix_(own, states)], -off[:, column], level.scale[states]
                )
    return along


def _levels(model: Model, rows: _Constraints, kept: NDArray[np.bool_]) -> tuple[_LevelRows, _LevelRows]:
    """Positions, then velocities; without the states that are kept."""
    level = np.array([c.level for c in model.checks])
    positions = rows.pattern[level == Level.POSITION].any(axis=0)
    nominal = np.array([v.nominal[j] for v in model.declaration.states for j in range(v.n)])
    scale = np.where(nominal != 0, np.abs(nominal), 1.0)
    reached = moved_by_impulses(rows.terms) & ~positions
    return (
        _LevelRows(level == Level.POSITION, positions & ~kept, scale, False),
        _LevelRows(level == Level.VELOCITY, reached & ~kept, scale, True),
    )


def _placed(rows: _Constraints, x: Array, part: _LevelRows, kept: NDArray[np.bool_], names: list[str]) -> Array:
    """x on the constraints of a level; DeclarationError if they cannot be met."""
    now = _projected(rows, x, part)
    _require(rows, now, part, [names[i] for i in np.flatnonzero(kept)], names)
    return now


def _kept(model: Model, names: list[str], keep: list[str]) -> NDArray[np.bool_]:
    kept = np.zeros(len(names), bool)
    for name in keep:
        found = [i for i, n in enumerate(names) if n == name or n.partition("[")[0] == name]
        if not found:
            bare = list(dict.fromkeys(n.partition("[")[0] for n in names))
            close = get_close_matches(name, [*names, *bare], 5)
            raise DeclarationError(
                model.name, f"has no state {name}", f"{'close' if close else 'states'}: {', '.join(close or bare)}"
            )
        kept[found] = True
    return kept


class _Constraints:
    """The hidden constraints of a model as functions of the state."""

    def __init__(self, model: Model, p: Array, t: float):
        d = model.declaration
        self.terms = extract(d)
        checks, z = list(model.checks), costate_symbols(d)
        rows = ca.vertcat(ca.SX(0, 1), *check_rows(self.terms, checks))
        apart = ca.vertcat(ca.SX(0, 1), *check_rows(self.terms, checks, z))
        jac = ca.jacobian(rows, d.x)
        forces = jac - ca.substitute(ca.jacobian(apart, d.x), z, costates(self.terms))
        symbols = [d.x, ca.vertcat(*(p.sx for p in d.parameters)), time]
        H, hessian = ca.vertcat(*component_energies(self.terms)), ca.hessian(d.hamiltonian, d.x)[0]
        exprs = (rows, jac, H, hessian, forces, ca.jacobian(H, d.x))
        self._functions = [ca.Function("f", symbols, [e]) for e in exprs]
        self._rows = symbols, rows
        self._fixed = (p, t)
        #: rows x states, and states x states coupled by H'': what can be other than zero
        self.pattern, self.coupled = (np.array(ca.DM(e.sparsity(), 1).full(), bool) for e in (jac, hessian))
        self.labels = [f"{c.name} ({c.level})" for c in model.checks]
        self.names = [c.name for c in model.checks]
        self.size, self.model = model.check_scale, model.name

    def _at(self, i: int, x: Array) -> Array:
        return self._functions[i](x, *self._fixed).full()

    def values(self, x: Array) -> Array:
        return self._at(0, x).ravel()

    def jacobian(self, x: Array) -> Array:
        return self._at(1, x)

    def by_parameters(self, x: Array) -> Array:
        """Rows x parameters."""
        symbols, rows = self._rows
        return ca.Function("f", symbols, [ca.jacobian(rows, symbols[1])])(x, *self._fixed).full()

    def energies(self, x: Array) -> Array:
        """H by component."""
        return self._at(2, x).ravel()

    def forces(self, x: Array) -> Array:
        """A^T dz/dx, rows x states, against which an impulse acts; the coefficients A stay as they are."""
        return self._at(4, x)

    def work(self, start: Array, end: Array) -> Array:
        """int (grad H)^T dx on the way from start to end by component, exact for H of degree 10 along it."""
        d = end - start
        if not d.any():
            return np.zeros(len(self.energies(start)))
        points, weights = np.polynomial.legendre.leggauss(5)
        parts = [w / 2 * (self._at(5, start + (1 + s) / 2 * d) @ d) for s, w in zip(points, weights, strict=True)]
        return np.sum(parts, axis=0)

    def hessian(self, x: Array) -> Array:
        return self._at(3, x)


@dataclass(frozen=True)
class _LevelRows:
    """Rows of one level and the states that may move for them; `energetic`: least in H'', else relative to `scale`."""

    rows: NDArray[np.bool_]
    free: NDArray[np.bool_]
    scale: Array
    energetic: bool

    def parts(self, f: _Constraints) -> list[tuple[Array, Array]]:
        """(rows, states) that have to do with each other."""
        rows, states = np.flatnonzero(self.rows), np.flatnonzero(self.free)
        touched = csr_matrix(f.pattern[np.ix_(rows, states)])
        among = csr_matrix(f.coupled[np.ix_(states, states)]) if self.energetic else None
        _, part = connected_components(block_array([[csr_matrix((len(rows), len(rows))), touched], [touched.T, among]]))
        of_row, of_state = part[: len(rows)], part[len(rows) :]
        return [(rows[of_row == i], states[of_state == i]) for i in np.unique(of_row)]


def _projected(f: _Constraints, x: Array, level: _LevelRows) -> Array:
    """x with the violated parts of a level projected."""
    if not level.rows.any() or not level.free.any():
        return x
    metric = f.hessian(x) if level.energetic else np.diag(level.scale**-2)
    for rows, states in level.parts(f):
        if not np.all(np.abs(f.values(x)[rows]) <= CONSISTENCY * f.size[rows]):
            gradient = f.forces if level.energetic else f.jacobian
            x = _newton(f, gradient, x, rows, states, metric[np.ix_(states, states)], level.scale[states])
    return x


def _newton(
    f: _Constraints,
    gradient: Callable[[Array], Array],
    x: Array,
    rows: Array,
    states: Array,
    metric: Array,
    scale: Array,
) -> Array:
    """Least changes of `states` in `metric` until the chosen constraints hold, or no longer improve."""
    for _ in range(ITERATIONS):
        c, jac = f.values(x)[rows], gradient(x)[np.ix_(rows, states)]
        if np.all(np.abs(c) <= 1e-6 * CONSISTENCY * f.size[rows]):
            break
        step = _least(metric, jac, -c, scale)
        if not np.isfinite(step).all():
            break
        x = x.copy()
        x[states] += step
    return x


def _least(metric: Array, jac: Array, c: Array, scale: Array) -> Array:
    """min 1/2 d^T metric d s.t. jac d = c; states without energy give way for nothing, by least changes of their own."""
    idle = ~metric.any(axis=1)
    d = np.zeros(len(scale))
    rest = np.eye(len(c))  # combinations of rows that the idle states cannot meet
    if idle.any():
        left, s, _ = np.linalg.svd(jac[:, idle] * scale[idle])
        rest = left[:, int(np.sum(s > TOLERANCE * max(s.max(initial=0.0), 1e-300))) :].T
    if not idle.all() and rest.size:
        inverse, own = np.linalg.pinv(metric[np.ix_(~idle, ~idle)]), rest @ jac[:, ~idle]
        d[~idle] = inverse @ own.T @ np.linalg.pinv(own @ inverse @ own.T, rcond=TOLERANCE, hermitian=True) @ rest @ c
    if idle.any():
        d[idle] = scale[idle] * (np.linalg.pinv(jac[:, idle] * scale[idle], rcond=TOLERANCE) @ (c - jac @ d))
    return d


def _require(f: _Constraints, x: Array, level: _LevelRows, kept: list[str], names: list[str]) -> None:
    """Raise DeclarationError with the equations of a level that do not hold at x, and the reason where that is clear."""
    values, rows = f.values(x), level.rows
    bad = [i for i in np.flatnonzero(rows) if not abs(values[i]) <= CONSISTENCY * f.size[i]]
    if not bad:
        return
    left = ", ".join(f"{f.labels[i]} residual {values[i]:.6g} (tolerance {CONSISTENCY * f.size[i]:.3g})" for i in bad)
    jac = f.jacobian(x)
    remedy = _contradiction(f, jac, values, rows, level.free)
    if not remedy:
        touched = {names[j] for i in bad for j in np.flatnonzero(jac[i])}
        held = [n for n in kept if n in touched]
        remedy = f"Keep fewer of {', '.join(held[:12])}, or start nearer" if held else "Start nearer"
    raise DeclarationError(f.model, f"no consistent start near the given one; left over: {left}", remedy, "start")


def _contradiction(f: _Constraints, jac: Array, values: Array, rows: Array, free: Array) -> str:
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
