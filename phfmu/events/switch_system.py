"""The equations of a model with switches at an instant, linear in what follows: rates, algebraic variables, impulses.

    E x' = f(x, z, a),   0 = g(x, z, a),   z = E^-T grad H

Modes enter as parameters.  With it a mode is tested (`comply.py`) and entered.  On entering, states jump along L = E^-1 df/da N
only, N the null space of dg/da: what of the algebraic variables may be an impulse.  Then

    c = N^T g = 0 after it,   S = L^T H'' L,   x+ = x- + L m,   m = -S^-1 c-,   lost = -1/2 m^T (c- + c+).

Null spaces of small matrices that may be singular: their bases, and solutions of least norm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import local

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import _sx, time
from phfmu.terms.canonical import member
from phfmu.terms.extract import extract
from phfmu.terms.extract_energy import component_energies
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


def inverse(S: Array) -> Array:
    """Inverse of a square matrix, scaled; of what depends on each other that which is least in norm."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(S)), np.finfo(float).tiny))
    if len(S) == 1 and S[0, 0] != 0.0:
        return 1.0 / S
    return np.linalg.pinv(S / np.outer(scale, scale), rcond=RANK) / np.outer(scale, scale)


#: null spaces that are kept
KNOWN = 256
#: times that the equation of an impulse is solved; the second and third correct rounding
PASSES = 3


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
class Entry:
    """How a mode is entered: states after it, energy that each component gets (J), what is lost, and the impulses of the rows."""

    x: Array
    energy: Array
    impulse: Array

    @property
    def lost(self) -> float:
        """Energy that the jump dissipates (J)."""
        return -float(self.energy.sum())


@dataclass(frozen=True)
class Equations:
    """They as expressions of x, a, u, p and time: `rows` as in Rates, then the diagonal of E; `gradients`, dH/dx by component."""

    x: ca.SX
    a: ca.SX
    u: ca.SX
    p: ca.SX
    rows: list[ca.SX]
    gradients: ca.SX


@dataclass(frozen=True)
class Undetermined:
    """A direction of the algebraic variables: `row` (na) along it, to stand in the row of variable `at`."""

    at: int
    row: Array


class _Buffered:
    """A function of vectors and numbers with dense matrices as results, on memory of its own in each thread.

    At a change of modes it is called some ten times, and a call by way of CasADi's matrices costs as much as a step.
    """

    def __init__(self, name: str, args: Sequence[ca.SX], results: Sequence[ca.SX]):
        shapes = [r.shape for r in results]
        ends = np.cumsum([0, *(rows * columns for rows, columns in shapes)])
        self._places = [(slice(a, b), shape) for a, b, shape in zip(ends[:-1], ends[1:], shapes, strict=True)]
        self._sizes, self._size = [a.numel() for a in args], int(ends[-1])
        column = ca.vertcat(ca.SX(0, 1), *(ca.vec(ca.densify(r)) for r in results))
        self._f, self._own = ca.Function(name, list(args), [column]), local()

    def __call__(self, *args: Array | float) -> list[Array]:
        own = self._own
        if not hasattr(own, "call"):
            own.args, own.result = [np.zeros(n) for n in self._sizes], np.zeros(self._size)
            own.buffer, own.call = self._f.buffer()
            for i, a in enumerate(own.args):
                own.buffer.set_arg(i, memoryview(a))  # type: ignore
            own.buffer.set_res(0, memoryview(own.result))  # type: ignore
        for mine, given in zip(own.args, args, strict=True):
            mine[:] = given
        own.call()
        found = own.result.copy()
        return [found[place].reshape(shape, order="F") for place, shape in self._places]


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
        self._masses = _Buffered("E", [p], [mass])
        out = [f, ca.jacobian(f, x), ca.jacobian(f, a), g, ca.jacobian(g, x), ca.jacobian(g, a)]
        out += [c, ca.jacobian(c, x), ca.jacobian(c, a), gap]
        self._rates = _Buffered("rates", [x, a, u, p, time], out)
        gradients = ca.jacobian(ca.vertcat(*component_energies(terms)), x)
        self._energy = _Buffered("energy", [x, p], [gradients])
        self.equations = Equations(x, a, u, p, [*out, mass], gradients)
        self.owners = [member(terms.members, s.owner) for s in model.switches]
        names = [n for v in symbolic.parameters for n in v.names()]
        self._switches = model.switches
        self.places = [names.index(s.mode_name) for s in model.switches]
        variables = [n for v in symbolic.algebraics for n in v.names()]
        self.multipliers = [variables.index(s.multiplier.names()[0]) for s in model.switches]
        self.nominal = np.array([n for v in symbolic.algebraics for n in v.nominal])
        self.power = max([s.nominal * s.multiplier.nominal[0] for s in model.switches], default=1.0)
        starts = (symbolic.states, symbolic.algebraics, symbolic.parameters)
        self._start = [np.array([s for v in vs for s in v.start], float) for vs in starts]
        self._known = dict[bytes, Array]()
        self._undetermined: dict[tuple[int, ...], tuple[Undetermined, ...]] = {}
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
        found = self._rates(at.x, at.a, at.u, at.p, at.t)
        return Rates(*(o[:, 0] if i in (0, 3, 6, 9) else o for i, o in enumerate(found)))

    def masses(self, p: Array) -> Array:
        """The diagonal of E."""
        return self._masses(p)[0].ravel()

    def undetermined(self, mode: Sequence[int]) -> tuple[Undetermined, ...]:
        """Directions of the algebraic variables that no row contains."""
        key = tuple(mode)
        if key not in self._undetermined:
            self._undetermined[key] = self._find_undetermined(key)
        return self._undetermined[key]

    def _find_undetermined(self, mode: tuple[int, ...]) -> tuple[Undetermined, ...]:
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
        return tuple(Undetermined(int(i), n[i] * n) for i, n in zip(pivots(directions), scaled.T, strict=True))

    def _free(self, ga: Array) -> Array:
        """Directions of the scaled algebraic variables that no row g determines, a column each; dg/da is mostly the mode's."""
        key = ga.tobytes()
        if key not in self._known:
            if len(self._known) >= KNOWN:
                self._known.clear()
            self._known[key] = null_space(scaled_rows(ga * self.nominal), len(self.nominal))
        return self._known[key]

    def enter(self, at: At) -> Entry:
        """The jump that the mode in at.p asks for; states stay where they satisfy it."""
        x, impulse = at.x.copy(), np.zeros(0)
        (before,) = self._energy(x, at.p)
        found, mass = self.rates(at), self.masses(at.p)
        N = self._free(found.ga) * self.nominal[:, None]
        L = found.fa @ N / mass[:, None]
        moving = np.flatnonzero(np.abs(L / self._size[0][:, None]).max(axis=0, initial=0) > RANK) if L.size else []
        N, L = N[:, moving], L[:, moving]
        if L.shape[1] == 0:
            return Entry(x, np.zeros(len(before)), impulse)
        impulse = np.zeros(len(self.nominal))
        S_inverse = inverse(N.T @ found.gx @ L)
        for _ in range(PASSES):
            c = N.T @ self.rates(At(x, at.a, at.u, at.p, at.t)).g
            m = -(S_inverse @ c)
            x = x + L @ m
            impulse += N @ m
        (after,) = self._energy(x, at.p)
        moved = x - at.x
        return Entry(x, (before + after) @ moved / 2, impulse)


def _fed(pair: object) -> ca.SX:
    port = pair.port  # type: ignore[attr-defined]
    return ca.SX(0) if port.bound is not None else ca.SX(_sx(port.source))[pair.j]  # type: ignore[attr-defined]


def _bound(pair: object, u: ca.SX) -> ca.SX:
    port = pair.port  # type: ignore[attr-defined]
    return port.bound[pair.j] if port.bound is not None else u  # type: ignore[attr-defined]
