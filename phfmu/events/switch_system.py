"""The equations of a model with switches at an instant, linear in what follows: rates, algebraic variables, impulses.

    E x' = f(x, z, a),   0 = g(x, z, a),   z = E^-T grad H

Modes enter as parameters.  Compiled code tests and enters modes with it (`engine/runtime/modes`).

Null spaces of small matrices that may be singular.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import _sx, time
from phfmu.terms.extraction.extract import extract
from phfmu.terms.extraction.extract_energy import component_energies
from phfmu.terms.port_impulses import masses
from phfmu.terms.rows import costates, flow_expressions
from phfmu.terms.term import CLOSED, CONSTRAINT, MASS_BLOCK

Array = NDArray[np.float64]

#: singular values below this part of the largest are none
RANK = 1e-10


def scaled_rows(matrix: Array) -> Array:
    """Rows divided by their largest entry, without those that are zero."""
    largest = np.abs(matrix).max(axis=1, initial=0)
    return matrix[largest > 0] / largest[largest > 0, None]


def null_space(matrix: Array, n: int) -> Array:
    """An orthonormal basis of the null space of rows of length n, a column each."""
    if not matrix.size:
        return np.eye(n)
    _, values, v = np.linalg.svd(matrix)
    rank = int((values > RANK * max(values[0], 1.0)).sum())
    return v[rank:].T


def apart(N: Array) -> Array:
    """Orthonormal columns with the same span: those that share no entries stay apart."""
    parts, left = [], list(range(len(N)))
    coupled = np.abs(N @ N.T) > RANK
    while left:
        group, queue = set(), [left[0]]
        while queue:
            i = queue.pop()
            if i not in group:
                group.add(i)
                queue += [j for j in left if coupled[i, j]]
        left = [i for i in left if i not in group]
        rows = sorted(group)
        own = np.zeros_like(N)
        own[rows] = N[rows]
        u, s, _ = np.linalg.svd(own, full_matrices=False)
        parts.append(u[:, s > 0.5])
    return np.hstack(parts) if parts else N


def pivots(N: Array) -> list[int]:
    """A row for each column, so that the matrix of these rows is regular."""
    left, out = N.copy(), []
    for j in range(N.shape[1]):
        i = int(np.argmax(np.abs(left[:, j])))
        out.append(i)
        left[:, j + 1 :] -= np.outer(left[:, j], left[i, j + 1 :] / left[i, j])
        left[i] = 0.0
    return out


@dataclass(frozen=True)
class At:
    """An instant: states x, algebraic variables a, inputs u, parameters p (modes among them), time t."""

    x: Array
    a: Array
    u: Array
    p: Array
    t: float


@dataclass(frozen=True)
class Rates:
    """Rows and their derivatives at an instant:  f (n1), g (na), c (switches) and d/dx, d/da of each."""

    f: Array
    fx: Array
    fa: Array
    g: Array
    gx: Array
    ga: Array
    c: Array
    cx: Array
    ca: Array
    gap: Array


@dataclass(frozen=True)
class Equations:
    """Equations in x, a, u, p and time: `rows` as in Rates, then the diagonal of E; `gradients`, dH/dx by component."""

    x: ca.SX
    a: ca.SX
    u: ca.SX
    p: ca.SX
    rows: list[ca.SX]
    gradients: ca.SX


@dataclass(frozen=True)
class UndeterminedDirection:
    """A direction of the algebraic variables: `row` (na) along it, to stand in the row of variable `at`."""

    at: int
    row: Array


class SwitchSystem:
    """`model` is declared with switches, `symbolic` has their modes as symbols in J and R."""

    def __init__(self, model: PHDAE, symbolic: PHDAE):
        terms = extract(symbolic)
        if terms.of(CONSTRAINT) or terms.of(MASS_BLOCK) or terms.of(CLOSED):
            raise DeclarationError(
                model.name,
                "has switches together with holonomic constraints or an E that is no constant diagonal",
                "declare the constraint as a switch on its velocities, use coordinates with a diagonal E",
                "switch",
            )
        x, p = symbolic.x, ca.vertcat(ca.SX(0, 1), *(v.sx for v in symbolic.parameters))
        a, u = ca.vertcat(ca.SX(0, 1), *(v.sx for v in symbolic.algebraics)), ca.SX.sym("u", terms.nu)
        inputs = [u[i] if pair.port.external else _fed(pair) for i, pair in enumerate(terms.pairs)]
        z = costates(terms)
        f, g = flow_expressions(terms, z, ca.vertcat(ca.SX(0, 1), *inputs))
        old = ca.vertcat(ca.SX(0, 1), *(pair.port.u[pair.j] for pair in terms.pairs))
        fed = ca.vertcat(ca.SX(0, 1), *(_bound(pair, inputs[i]) for i, pair in enumerate(terms.pairs)))
        costate = ca.vertcat(ca.SX(0, 1), *(v.z for v in symbolic.states))
        c, gap = (
            ca.substitute([ca.vertcat(ca.SX(0, 1), *exprs)], [costate, old], [z, fed])[0]
            for exprs in (
                (s.rate(model.effort) for s in model.switches),
                (ca.SX(0) if s.gap is None else ca.SX(_sx(s.gap)) for s in model.switches),
            )
        )
        mass = masses(terms)
        out = [f, ca.jacobian(f, x), ca.jacobian(f, a), g, ca.jacobian(g, x), ca.jacobian(g, a)]
        out += [c, ca.jacobian(c, x), ca.jacobian(c, a), gap]
        self._rates = ca.Function("rates", [x, a, u, p, time], [ca.densify(r) for r in out])
        gradients = ca.jacobian(ca.vertcat(*component_energies(terms)), x)
        self.equations = Equations(x, a, u, p, [*out, mass], gradients)
        self.owners = [terms.member(s.owner) for s in model.switches]
        names = [n for v in symbolic.parameters for n in v.names()]
        self._switches = model.switches
        self.places = [names.index(s.mode_name) for s in model.switches]
        variables = [n for v in symbolic.algebraics for n in v.names()]
        self.multipliers = [variables.index(s.multiplier.names()[0]) for s in model.switches]
        self.nominal = np.array([n for v in symbolic.algebraics for n in v.nominal])
        self.power = max([s.nominal * s.multiplier.nominal[0] for s in model.switches], default=1.0)
        starts = (symbolic.states, symbolic.algebraics, symbolic.parameters)
        self._start = [np.array([s for v in vs for s in v.start], float) for vs in starts]
        self._undetermined: dict[tuple[int, ...], tuple[UndeterminedDirection, ...]] = {}
        self.size = np.array([n for v in symbolic.states for n in v.nominal])
        self._size = self.size, terms.nu

    @property
    def between_inputs(self) -> list[str]:
        """Switches whose c depends on inputs from outside and on nothing inside."""
        x, a, p = self._start
        found = self.rates(At(x, a, np.zeros(self._size[1]), p, 0.0))
        inside = [bool(row.any()) for row in np.hstack([found.cx, found.ca])]
        return [s.name for s, own in zip(self._switches, inside, strict=True) if not own]

    def in_mode(self, p: Array, mode: Sequence[int]) -> Array:
        """Parameters with the modes set."""
        p = p.copy()
        p[self.places] = mode
        return p

    def rates(self, at: At) -> Rates:
        """The rows at an instant."""
        found = [np.array(v) for v in self._rates(at.x, at.a, at.u, at.p, at.t)]
        return Rates(*(o[:, 0] if i in (0, 3, 6, 9) else o for i, o in enumerate(found)))

    def undetermined(self, mode: Sequence[int]) -> tuple[UndeterminedDirection, ...]:
        """Directions of the algebraic variables that no row contains."""
        key = tuple(mode)
        if key not in self._undetermined:
            self._undetermined[key] = self._find_undetermined(key)
        return self._undetermined[key]

    def _find_undetermined(self, mode: tuple[int, ...]) -> tuple[UndeterminedDirection, ...]:
        x, a, p = self._start
        size, nu = self._size
        draw = np.random.default_rng(0)
        rows = []
        for _ in range(2):
            found = self.rates(At(x, a, np.zeros(nu), self.in_mode(p, mode), 0.0))
            rows += [found.fa * self.nominal, found.ga * self.nominal]
            x = x + size * draw.uniform(0.1, 1.0, len(x))
        if not self.nominal.size:
            return ()
        directions = apart(null_space(scaled_rows(np.vstack(rows)), len(self.nominal)))
        directions = np.where(np.abs(directions) > RANK, directions, 0.0)
        scaled = directions / self.nominal[:, None] * np.sqrt(self.power)
        return tuple(UndeterminedDirection(int(i), n[i] * n) for i, n in zip(pivots(directions), scaled.T, strict=True))


def _fed(pair: object) -> ca.SX:
    port = pair.port  # type: ignore[attr-defined]
    return ca.SX(0) if port.bound is not None else ca.SX(_sx(port.source))[pair.j]  # type: ignore[attr-defined]


def _bound(pair: object, u: ca.SX) -> ca.SX:
    port = pair.port  # type: ignore[attr-defined]
    return port.bound[pair.j] if port.bound is not None else u  # type: ignore[attr-defined]
