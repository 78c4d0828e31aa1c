"""Index reduction of a declaration: what solvers of ordinary and of index-1 systems are given.

From  E x' = (J - R) z + B u  with the rates  x' = E^-1 f(t, x, a)  put into the algebraic rows h:

    rows that contain algebraic variables stay,                      0 = h(t, x, a)
    hidden rows (Kirchhoff at bare nodes) are differentiated once,   0 = dh/dt + gamma h
    holonomic constraints g(q) = 0 twice,                            0 = g'' + 2 gamma g' + gamma^2 g

gamma is Baumgarte's stabilisation (Comput. Methods Appl. Mech. Eng. 1, 1972).  Built straight from the declaration: it shares
only the choice of the rows to differentiate with the package's own schemes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import _sx, time
from phfmu.studies.bench.precision.flat import FlatSystem
from phfmu.terms.extraction.extract import extract
from phfmu.terms.hidden import HiddenConstraints
from phfmu.terms.term import Terms

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """An index-1 system  x' = rate(t, x, w, live),  0 = rows(t, x, w, live)  as CasADi expressions.

    x (n1): states;  w: algebraic variables, then rates of those among them that hidden rows contain;  live: parameters and
    inputs that events change, all others are numbers.  `checks`: hidden constraints [g' or h | g];  H: the Hamiltonian;
    `position_rows`: the rows of holonomic constraints.
    """

    t: ca.SX
    x: ca.SX
    w: ca.SX
    live: ca.SX
    live_names: tuple[str, ...]
    live_start: Array
    x0: Array
    rate: ca.SX
    rows: ca.SX
    checks: ca.SX
    H: ca.SX
    position_rows: tuple[int, ...] = ()

    @cached_property
    def matrix(self) -> ca.SX:
        """d rows / d w."""
        return ca.jacobian(self.rows, self.w)

    @property
    def linear(self) -> bool:
        """True if the rows are linear in w, so that w can be eliminated in closed form."""
        return not ca.depends_on(ca.veccat(self.matrix), self.w)

    @property
    def arguments(self) -> list[ca.SX]:
        return [self.t, self.x, self.live]

    @cached_property
    def ode(self) -> ca.Function:
        """(t, x, live) -> x', algebraic variables eliminated."""
        if not self.w.numel():
            return ca.Function("ode", self.arguments, [self.rate])
        if not self.linear:
            return self._ode_by_newton()
        offset = ca.substitute(self.rows, self.w, ca.SX.zeros(self.w.numel()))
        w = _solve(self.matrix, -offset, self._is_definite())
        return ca.Function("ode", self.arguments, [ca.substitute(self.rate, self.w, w)])

    @property
    def w0(self) -> Array:
        """Algebraic variables at the start."""
        return self.solve_w(0.0, self.x0, self.live_start)

    @cached_property
    def _newton(self) -> ca.Function:
        return ca.Function("h", [self.w, *self.arguments], [self.rows, self.matrix])

    def solve_w(self, t: float, x: Array, live: Array) -> Array:
        """Algebraic variables at a state, by Newton's method from zero."""
        w = np.zeros(self.w.numel())
        for _ in range(50 if w.size else 0):
            h, a = self._newton(w, t, x, live)
            d = np.linalg.lstsq(np.array(a), np.array(h).ravel(), rcond=None)[0]
            w = w - d
            if np.linalg.norm(d) <= 1e-13 * (1.0 + np.linalg.norm(w)):
                break
        return w

    def _is_definite(self) -> bool:
        """True if the matrix is symmetric and definite at the start: then L D L^T without pivoting is safe."""
        a = np.array(ca.Function("a", self.arguments, [self.matrix])(0.0, self.x0, self.live_start))
        if not np.allclose(a, a.T, rtol=1e-12, atol=1e-14 * np.abs(a).max(initial=0.0)):
            return False
        values = np.linalg.eigvalsh(a)
        return bool(values.min() > 0 or values.max() < 0)

    def _ode_by_newton(self) -> ca.Function:
        g = ca.Function("g", [self.w, ca.veccat(*self.arguments)], [self.rows])
        solver = ca.rootfinder("solver", "fast_newton", g)
        args = [ca.MX.sym(n, s.numel()) for n, s in zip(("t", "x", "live"), self.arguments, strict=True)]
        w = solver(ca.DM(self.w0), ca.veccat(*args))
        rate = ca.Function("rate", [*self.arguments, self.w], [self.rate])
        return ca.Function("ode", args, [rate(*args, w)])


def reduced(declaration: PHDAE, *, gamma: float = 20.0, live: Collection[str] = ()) -> ReducedSystem:
    """The index-1 form of a declaration; `live`: scalar names of parameters and inputs kept as symbols.

    gamma: Baumgarte stabilisation [1/s].  Errors: DeclarationError of the extraction.
    """
    terms = extract(declaration)
    hidden = terms.found(HiddenConstraints)
    system = FlatSystem(declaration, terms)
    f, a = system.right_hand_side(), system.a
    rate = system.rates(f[: terms.n1])
    rows, extra, rates_of = _algebraic_rows(terms, hidden, system, f[terms.n1 :], rate, gamma)
    w = ca.vertcat(a, rates_of)
    checks = ca.vertcat(*extra)
    fixed, values, live_symbols, names, start = _fixed(declaration, live)
    out = [rate, ca.vertcat(*rows) if rows else ca.SX(0, 1), checks, declaration.hamiltonian]
    out = ca.substitute(out, [fixed], [values]) if fixed.numel() else out
    x0 = np.array([s for v in declaration.states for s in v.start], float)
    _require_inertia(declaration, _numbers(declaration, fixed, values)[0])
    rate, rows, checks, H = out
    return ReducedSystem(
        time, system.x, w, live_symbols, names, start, x0, rate, rows, checks, H, tuple(system.constraint_rows)
    )


def _algebraic_rows(
    terms: Terms, hidden: HiddenConstraints, system: FlatSystem, h: ca.SX, rate: ca.SX, gamma: float
) -> tuple[list[ca.SX], list[ca.SX], ca.SX]:
    """Rows for w, hidden constraints (first derivatives, then positions), and the symbols of rates in w."""
    chosen = sorted(hidden.solved_by.values())
    b = ca.SX.sym("b", len(chosen))
    position = {row: g for row, g in zip(system.constraint_rows, system.constraints, strict=True)}
    rows, velocity, positions, originals = [], [], [], []
    for i in range(terms.na):
        if i not in hidden.rows:
            rows.append(h[i])
            continue
        drift = ca.jtimes(h[i], system.x, rate) + ca.jacobian(h[i], time)
        for j, v in enumerate(chosen):
            drift += ca.jacobian(h[i], system.a[v]) * b[j]
        if i in hidden.solved_by:
            originals.append(h[i])
            rows.append(drift)
        elif i in position:
            rows.append(drift + 2 * gamma * h[i] + gamma**2 * position[i])
            velocity.append(h[i])
            positions.append(position[i])
        else:
            rows.append(drift + gamma * h[i])
            velocity.append(h[i])
    return rows + originals, velocity + positions, b


def stabilised(system: ReducedSystem) -> tuple[ca.SX, ca.SX]:
    """y = (x, w, mu) and (x', 0) of the form with both levels of holonomic constraints:

        x' = rate(x, w) - Dg^T mu,   0 = Dg z_v,   0 = g        (multipliers mu vanish on solutions; index 2)

    Source: Gear, Gupta, Leimkuhler 1985.  Systems with other hidden rows, or none, keep their index-1 form and y = (x, w).
    """
    m = len(system.position_rows)
    if not m or system.checks.numel() != 2 * m:
        return ca.vertcat(system.x, system.w), ca.vertcat(system.rate, system.rows)
    velocity, g, mu = system.checks[:m], system.checks[m:], ca.SX.sym("mu", m)
    rows = ca.SX(system.rows)
    for j, i in enumerate(sorted(system.position_rows)):
        rows[i] = velocity[j]
    rate = system.rate - ca.mtimes(ca.jacobian(g, system.x).T, mu)
    return ca.vertcat(system.x, system.w, mu), ca.vertcat(rate, rows, g)


def _diagonal(e: Any) -> ca.SX:
    """Diagonal of a block of E, which may be a number, a column or a matrix."""
    matrix = ca.SX(_sx(e))
    return ca.densify(ca.diag(matrix)) if matrix.shape[0] == matrix.shape[1] > 1 else ca.densify(matrix)


def _numbers(declaration: PHDAE, fixed: ca.SX, values: ca.SX) -> list[ca.SX]:
    """The diagonal of E with parameters as numbers."""
    diagonal = ca.vertcat(*map(_diagonal, declaration.E.values())) if declaration.E else ca.SX(0, 1)
    return ca.substitute([diagonal], [fixed], [values]) if fixed.numel() else [diagonal]


def _require_inertia(declaration: PHDAE, diagonal: ca.SX) -> None:
    """ValueError where a state has no inertia of its own: its rate does not follow from E x' = f."""
    entries = ca.vertsplit(diagonal) if diagonal.numel() else []
    if any(e.is_constant() and float(e) == 0 for e in entries):
        raise ValueError(
            f"{declaration.name}: E has zeros on its diagonal, so there is no ordinary differential equation x' = E^-1 f to "
            "compare with; give the states mass, or take them out with reduce_descriptor"
        )


def _solve(a: ca.SX, right: ca.SX, definite: bool) -> ca.SX:
    """a^-1 right in closed form: L D L^T (fill-reducing order) if definite, sparse QR else."""
    if definite:
        d, lt, p = ca.ldl(a)
        return ca.ldl_solve(right, d, lt, p)
    return ca.solve(a, right)


def _fixed(declaration: PHDAE, live: Collection[str]) -> tuple[ca.SX, ca.SX, ca.SX, tuple[str, ...], Array]:
    """Symbols that are numbers with their values, and live symbols with names and starts."""
    named: list[tuple[str, ca.SX, float]] = []
    for v in declaration.parameters:
        named += [(n, v.sx[j], s) for j, (n, s) in enumerate(zip(v.names(), v.start, strict=True))]
    for p in declaration.ports:
        if p.external:
            named += [(n, p.u[j], s) for j, (n, s) in enumerate(zip(p.input_names(), p.input_starts(), strict=True))]
    keep = [e for e in named if e[0] in live or e[0].partition("[")[0] in live]
    rest = [e for e in named if e not in keep]
    fixed = ca.vertcat(*(s for _, s, _ in rest)) if rest else ca.SX(0, 1)
    values = ca.densify(ca.SX(ca.DM([v for *_, v in rest]))) if rest else ca.SX(0, 1)
    symbols = ca.vertcat(*(s for _, s, _ in keep)) if keep else ca.SX(0, 1)
    return fixed, values, symbols, tuple(n for n, *_ in keep), np.array([v for *_, v in keep], float)


def live_values(system: ReducedSystem, start: Array, changes: Mapping[str, float]) -> Array:
    """Live values after `changes`; the bare name of a vector sets all its entries."""
    values = start.copy()
    for name, value in changes.items():
        for i, n in enumerate(system.live_names):
            if n == name or n.partition("[")[0] == name:
                values[i] = value
    return values
