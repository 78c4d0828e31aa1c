"""A plan as one function of CasADi, with its sparse Jacobians, evaluated for many points at a time.

With x = [states | t], unknowns w, inputs u at the nodes, parameters p and the step length h,

    F(x, w, u, p, h) = 0,     told = T(x, w, u, p, h),

F being the residual of the plan and T what the engines tell of its solution.  Along the directions theta of (p, u) asked for

    dw = W_x dx + W_theta dtheta = -(dF/dw)^-1 (F_x dx + F_theta dtheta),     dT = T_x dx + T_w dw + T_theta dtheta.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import TangentDirections
from phfmu.engine.build.machine_code import compiled
from phfmu.plan.buffered import BufferedFunction
from phfmu.plan.plan import Group, Plan

Array = NDArray[np.float64]

#: up to so many unknowns the matrices of many points are factored at once, as full ones
FULL = 160
#: numbers that are held at a time, at most
ROOM = 400_000
#: points of one call of a mapped function: any number of points is made of these, so that there are few mapped functions
TOGETHER = (512, 64, 8, 1)
#: evaluated so often, expressions of so many operations are worth compiling
OFTEN, LONG = 4_000, 300

ALL = slice(None)


@dataclass(frozen=True)
class PlanPoint:
    """Points at which a plan is linearised, a row each: x (n x nx + 1), w (n x nw), u (n x k nu), p (n x np), h (n)."""

    x: Array
    w: Array
    u: Array
    p: Array
    h: Array

    @property
    def arguments(self) -> tuple[Array, ...]:
        return self.x, self.w, self.u, self.p, self.h[:, None]


@dataclass(frozen=True)
class Response:
    """Per point: dw (n x nw x columns), the derivative of what is told (n x told x columns); columns are states, directions,
    inputs at single nodes, and where instants move t and h."""

    w: Array
    told: Array


class PlanFunction:
    """F and T of a plan; `told` chooses from `PlanRows` what T is.

    nodes: places of inputs at single nodes (of k nu), by which there are derivatives behind those by directions;  moves: those
    by t and h come last
    """

    def __init__(
        self,
        plan: Plan,
        told: Callable[[PlanRows], ca.SX],
        directions: TangentDirections,
        moves: bool = False,
        nodes: Sequence[int] = (),
    ):
        self.plan, self._rows, self._moves, self._nodes = plan, PlanRows(plan), moves, list(nodes)
        self._told, self._directions = told(self._rows), directions
        self.ntold = self._told.numel()

    @property
    def _arguments(self) -> list[ca.SX]:
        r = self._rows
        return [r.x, r.w, r.u, r.p, r.h]

    @cached_property
    def _along(self) -> PointwiseFunction:
        r, plan, d = self._rows, self.plan, self._directions
        held = [ca.vertcat(*(r.u[i * plan.nu + j] for i in range(plan.k))) for j in d.inputs]

        def by(expr: ca.SX) -> ca.SX:
            columns = [ca.jacobian(expr, r.x[: plan.nx]), ca.jacobian(expr, r.p[list(d.parameters)])]
            columns += [ca.sum2(ca.jacobian(expr, u)) for u in held]
            columns += [ca.jacobian(expr, r.u[self._nodes])] if self._nodes else []
            columns += [ca.jacobian(expr, v) for v in (r.x[plan.nx], r.h)] if self._moves else []
            return ca.horzcat(*columns)

        F, T = r.residual, self._told
        return PointwiseFunction(self._arguments, [ca.jacobian(F, r.w), by(F), ca.jacobian(T, r.w), by(T)])

    @cached_property
    def _residual(self) -> PointwiseFunction:
        return PointwiseFunction(self._arguments, [self._rows.residual, ca.jacobian(self._rows.residual, self._rows.w)])

    def response(self, at: PlanPoint) -> Response:
        """Derivatives of the solution w at each point, and of what is told of it."""
        plan, n = self.plan, len(at.h)
        width = plan.nx + self._directions.n + len(self._nodes) + 2 * self._moves
        w, told = np.zeros((n, plan.nw, width)), np.zeros((n, self.ntold, width))
        size = max(1, plan.nw * (min(plan.nw, FULL) + width) + self.ntold * (plan.nw + width))
        for some in _parts(n, max(1, ROOM // size)):
            A, F, T_w, T = self._along.at(at.arguments, some)
            w[some] = -_solved(A, F.full())
            told[some] = T.full() + T_w.times(w[some])
        return Response(w, told)

    def at_instants(self, t: Array, x: Array, u: Array, p: Array, a: Array) -> Array:
        """Derivatives of what the plan of an instant tells at n of them (n x told x columns); `a`: algebraic variables there."""
        plan, n = self.plan, len(t)
        w = np.zeros((n, plan.nw))
        w[:, plan.mean_w] = a[:, plan.mean_a]
        at = PlanPoint(np.column_stack([x, t]), w, u, np.broadcast_to(p, (n, plan.np)), np.ones(n))
        return self.response(PlanPoint(at.x, self.solved(at), at.u, at.p, at.h)).told

    def solved(self, at: PlanPoint, most: int = 20) -> Array:
        """Unknowns that solve F = 0, by Newton's method from `at.w`; ValueError where it does not converge."""
        w = at.w.copy()
        if not self.plan.nw:
            return w
        scale = np.maximum(np.abs(w).max(axis=0, initial=0.0), np.abs(self.plan.nominal))
        for some in _parts(len(w), max(1, ROOM // self.plan.nw**2)):
            before = np.inf
            for _ in range(most):
                F, A = self._residual.at(PlanPoint(at.x, w, at.u, at.p, at.h).arguments, some)
                move = _solved(A, F.full())[:, :, 0]
                w[some] -= move
                size = float(np.max(np.abs(move) / np.maximum(scale, 1e-300), initial=0.0))
                if size <= 1e-13 or (size <= 1e-9 and size > 0.3 * before):
                    break
                before = size
            else:
                raise ValueError(f"the values at an instant do not converge (last move {before:.3g} of their size)")
        return w


class PlanRows:
    """The residual of a plan and what is told beside it, in symbols x, w, u, p and h."""

    def __init__(self, plan: Plan):
        self.plan = plan
        self.x, self.w = ca.SX.sym("x", plan.nx + 1), ca.SX.sym("w", plan.nw)
        self.u, self.p, self.h = ca.SX.sym("u", plan.nu * plan.k), ca.SX.sym("p", plan.np), ca.SX.sym("h")
        resting = [int(i) for i in plan.hold.of(plan.hold.rests)]
        w = ca.SX(self.w)
        w[resting] = 0.0
        staged = [[g for g in plan.groups if g.stage == stage] for stage in (0, 1)]
        begun = ca.vertcat(w, self.u, self.h)
        Z = self._sums(staged[0], ca.vertcat(begun, ca.SX.zeros(plan.nz)), plan.nz)
        Y = ca.vertcat(begun, Z)
        R = self._sums(staged[1], Y, plan.nrow)
        for row, source, value, power in zip(
            plan.const_row, plan.const_src, plan.const_val, plan.const_pow, strict=True
        ):
            R[int(row)] += value * self.h ** int(power) * Y[int(source)]
        for i in resting:
            R[i] = self.w[i]
        if plan.ncondensed:
            Y[Y.numel() - plan.ncondensed :] = R[plan.nrow - plan.ncondensed :]
        self.Y, self.R = Y, R

    @property
    def residual(self) -> ca.SX:
        return self.R[: self.plan.nw]

    @property
    def outputs(self) -> ca.SX:
        """Outputs of the pairs, mean over the step (nq)."""
        return _total(self.plan.nq, [(i, b * y) for i, b, y, _ in self._pairs()])

    @property
    def outputs_at_nodes(self) -> ca.SX:
        """Outputs of the pairs that are fed from outside, node by node (k nu)."""
        plan = self.plan
        return ca.vertcat(*(self.R[plan.nw + i * plan.nq : plan.nw + i * plan.nq + plan.nu] for i in range(plan.k)))

    @property
    def work(self) -> ca.SX:
        """Energy that enters through each pair in the step (nq)."""
        plan = self.plan
        own = [(i, self.h * b * y * u) for i, b, y, u in self._pairs()]
        own += [(int(j), self.R[int(r)]) for j, r in zip(plan.work_pair, plan.work_row, strict=True)]
        return _total(plan.nq, own)

    def _pairs(self) -> list[tuple[int, float, ca.SX, ca.SX]]:
        """(pair, weight, output, input) at each node."""
        plan = self.plan
        return [
            (
                i,
                float(plan.weights[node]),
                self.R[plan.nw + node * plan.nq + i],
                self.Y[int(plan.pair_src[node * plan.nq + i])],
            )
            for node in range(plan.k)
            for i in range(plan.nq)
        ]

    @property
    def reported(self) -> ca.SX:
        """Rows that are told beside outputs: observables and residuals of hidden constraints."""
        plan = self.plan
        first, stop = plan.nw + plan.nq * plan.k, plan.nrow - plan.ncondensed
        return self.R[first:stop] if first < stop else ca.SX(0, 1)  # CasADi makes a row of nothing behind a single one

    @property
    def algebraics(self) -> ca.SX:
        """Algebraic variables (na)."""
        plan = self.plan
        table = zip(plan.mean_a, plan.mean_w, plan.mean_c, plan.mean_pow, strict=True)
        return _total(plan.na, [(int(a), c * self.h ** int(q) * self.Y[int(w)]) for a, w, c, q in table])

    def energies(self, result: int) -> ca.SX:
        """By component (ncomp): what is stored (0: in a step its change), or the rate of loss (1)."""
        found = []
        for g in self.plan.groups:
            if g.kernel.ledger is not None:
                f = _result(g.kernel.ledger, result)
                found += [(int(g.owner[i]), f(*self._taken(g, i, self.Y))) for i in range(g.n)]
        return _total(self.plan.ncomp, found)

    def _taken(self, g: Group, i: int, Y: ca.SX) -> list[ca.SX]:
        """Arguments of an instance of a kernel."""
        sources = zip((self.x, Y, self.p), (g.xi, g.yi, g.pi), strict=True)
        return [source[[int(j) for j in index[i]]] if index.shape[1] else ca.SX(0, 1) for source, index in sources]

    def _sums(self, groups: Sequence[Group], Y: ca.SX, n: int) -> ca.SX:
        found = []
        for g in groups:
            f, power = _result(g.kernel.function, 0), np.broadcast_to(g.power, g.oi.shape)
            for i in range(g.n):
                out = f(*self._taken(g, i, Y))
                found += [(int(g.oi[i, j]), self.h ** int(power[i, j]) * out[j]) for j in range(out.numel())]
        return _total(n, found)


def _result(function: Any, i: int) -> Any:
    """A kernel with one of its results."""
    arguments = function.sx_in()
    return ca.Function("part", arguments, [ca.densify(function.call(arguments)[i])])


def _total(n: int, parts: Sequence[tuple[int, ca.SX]]) -> ca.SX:
    """A column of n sums."""
    found = ca.SX.zeros(n)
    for i, value in parts:
        found[i] += value
    return found


@dataclass(frozen=True)
class SparseMatrices:
    """A sparse matrix at each of n points: entries (n x nnz)."""

    shape: tuple[int, int]
    row: NDArray[np.intp]
    col: NDArray[np.intp]
    values: Array

    def full(self) -> Array:
        found = np.zeros((len(self.values), *self.shape))
        found[:, self.row, self.col] = self.values
        return found

    def times(self, b: Array) -> Array:
        """Their products with matrices b (n x columns x width)."""
        found = np.zeros((len(b), self.shape[0], b.shape[2]))
        if self.shape[1] <= FULL:
            return np.matmul(self.full(), b)
        for row, col, values in zip(self.row, self.col, self.values.T, strict=True):
            found[:, row] += values[:, None] * b[:, col]
        return found


class PointwiseFunction:
    """Expressions of some arguments, at many points."""

    def __init__(self, arguments: list[ca.SX], results: list[ca.SX]):
        self._function = ca.Function("at", arguments, ca.cse([ca.SX(r) for r in results]))
        self._buffers: dict[int, BufferedFunction] = {}
        self._points, self._worth = 0, self._function.n_instructions() >= LONG

    def at(self, given: Sequence[Array], some: slice = ALL) -> list[SparseMatrices]:
        """The results at some of the points, of which `given` has the arguments (n x entries)."""
        given = [values[some] for values in given]
        self._points += len(given[0])
        if self._worth and self._points > OFTEN:
            self._function, self._worth = compiled(self._function), False
            self._buffers.clear()
        f = self._function
        found, done, n = [np.empty((len(given[0]), f.nnz_out(i))) for i in range(f.n_out())], 0, len(given[0])
        while done < n:
            size = next(t for t in TOGETHER if t <= n - done)
            buffer, part = self._buffer(size), slice(done, done + size)
            for own, values in zip(buffer.arg, given, strict=True):
                own[:] = values[part]
            buffer.call()
            for own, values in zip(found, buffer.res, strict=True):
                own[part] = values
            done += size
        matrices = []
        for i, values in enumerate(found):
            sparsity = f.sparsity_out(i)
            row, col = (np.array(t, np.intp) for t in sparsity.get_triplet())
            matrices.append(SparseMatrices(sparsity.shape, row, col, values))
        return matrices

    def _buffer(self, n: int) -> BufferedFunction:
        """The function mapped over n points."""
        if n not in self._buffers:
            f = self._function
            argument = [np.zeros((n, f.nnz_in(i))) for i in range(f.n_in())]
            self._buffers[n] = BufferedFunction(f, argument, [np.zeros((n, f.nnz_out(i))) for i in range(f.n_out())])
        return self._buffers[n]


def _parts(n: int, most: int) -> list[slice]:
    return [slice(i, min(i + most, n)) for i in range(0, n, most)]


def _solved(A: SparseMatrices, b: Array) -> Array:
    """A^-1 b at each point, rows scaled, with one step of refinement."""
    if not A.shape[0] or not b.shape[2]:
        return np.zeros_like(b)
    if A.shape[0] > FULL:
        return np.array([_solved_sparse(A, values, own) for values, own in zip(A.values, b, strict=True)])
    full = A.full()
    scale = 1.0 / np.maximum(np.abs(full).max(axis=2, keepdims=True), 1e-300)
    full, b = full * scale, b * scale
    if 2 * b.shape[2] >= A.shape[0]:  # one factorisation costs less than another pass over so many columns
        inverse = np.linalg.inv(full)
        found = np.matmul(inverse, b)
        return found + np.matmul(inverse, b - np.matmul(full, found))
    found = np.linalg.solve(full, b)
    return found + np.linalg.solve(full, b - np.matmul(full, found))


def _solved_sparse(A: SparseMatrices, values: Array, b: Array) -> Array:
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    scale = np.zeros(A.shape[0])
    np.maximum.at(scale, A.row, np.abs(values))
    scale = 1.0 / np.maximum(scale, 1e-300)
    matrix = csc_matrix((values * scale[A.row], (A.row, A.col)), shape=A.shape)
    factor, b = splu(matrix), b * scale[:, None]
    found = factor.solve(b)
    return found + factor.solve(b - matrix @ found)
