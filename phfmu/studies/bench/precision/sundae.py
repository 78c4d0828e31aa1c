"""SUNDIALS IDA through scikit-sundae, on the stabilised index-2 form of holonomic models.

Gear, Gupta, Leimkuhler (J. Comput. Appl. Math. 12, 1985):  q' = v - Dg^T mu,  M v' = f - Dg^T lambda,  0 = g,  0 = Dg v,
y = (x, w, mu) with the multipliers out of the error test (absolute tolerance 1e6), the Jacobian analytic, y and y' consistent.
Models without constraints: the index-1 form.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.studies.bench.precision.array_function import compiled_expression
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, missing
from phfmu.studies.bench.precision.peers import absolute
from phfmu.studies.bench.precision.problem import InitialValueProblem
from phfmu.studies.bench.precision.reduced import ReducedSystem, stabilised

Array = NDArray[np.float64]


def missing_ida() -> Iterator[Candidate]:
    """The remark that SUNDIALS is not installed; nothing where it is."""
    if find_spec("sksundae") is None:
        yield missing("SUNDIALS IDA", "not installed; pip install scikit-sundae")


def candidates(problem: InitialValueProblem, tolerances: Sequence[float]) -> Iterator[Candidate]:
    if remark := [*missing_ida()]:
        yield from remark
        return
    made: list[_Functions] = []

    def functions() -> _Functions:
        if not made:
            made.append(_Functions(problem))
        return made[0]

    for rtol in tolerances:
        yield Candidate("SUNDIALS IDA, GGL", f"rtol={rtol:g}", rtol, lambda r=rtol: _Ida(problem, functions(), r))


class ImplicitSystem:
    """F(t, y, y', live) = 0 as IDA takes it: F and dF/dy + c dF/dy' in machine code; the first n entries of y have rates."""

    def __init__(self, t: ca.SX, y: ca.SX, yp: ca.SX, residual: ca.SX, n: int, live: Sequence[ca.SX] = ()):
        arguments, c = [t, y, yp, *live], ca.SX.sym("c")
        matrix = ca.jacobian(residual, y) + c * ca.jacobian(residual, yp)
        self.n, self.size = n, y.numel()
        self._residual = compiled_expression("residual", arguments, residual)
        self._matrix = compiled_expression("matrix", [*arguments, c], matrix)

    def solver(self, rtol: float, atol: Array, *live: Array) -> Any:
        """IDA with the absolute tolerances `atol` (n); the other entries of y are out of its error test."""
        size, residual_of, matrix_of = self.size, self._residual, self._matrix

        def residual(t: float, y: Array, yp: Array, res: Array) -> None:
            res[:] = residual_of(t, y, yp, *live)

        def matrix(t: float, y: Array, yp: Array, res: Array, c: float, jac: Array) -> None:
            jac[:] = matrix_of(t, y, yp, *live, c).reshape(size, size, order="F")

        tolerances = np.full(size, 1e6)
        tolerances[: self.n] = atol
        IDA: Any = import_module("sksundae.ida").IDA
        return IDA(
            residual, jacfn=matrix, rtol=rtol, atol=tolerances, algebraic_idx=list(range(self.n, size)) or None,
            max_num_steps=10_000_000,
        )  # fmt: skip


def solved(solver: Any, start: float, times: Sequence[float] | Array, y: Array, yp: Array) -> Array:
    """y at the times (times x size) from a consistent y and y'; RuntimeError with what IDA says."""
    found = solver.solve(np.array([start, *times]), y, yp)
    if not found.success:
        raise RuntimeError(str(found.message))
    # with one interval the solver returns all of its own steps
    return np.array(found.y[1:] if len(times) > 1 else found.y[-1:])


class _Functions:
    """The stabilised system of a problem, compiled; the start."""

    def __init__(self, problem: InitialValueProblem):
        system = problem.system
        n, (y, residual) = system.x.numel(), stabilised(system)
        yp = ca.SX.sym("yp", y.numel())
        full = ca.vertcat(yp[:n], ca.SX.zeros(y.numel() - n)) - residual
        self.implicit = ImplicitSystem(system.t, y, yp, full, n, [system.live])

    def start(self, system: ReducedSystem, x: Array, live: Array, t: float) -> tuple[Array, Array]:
        """Consistent y and y' at a state on the constraints (mu = 0)."""
        size, n = self.implicit.size, self.implicit.n
        y, rate, w = np.zeros(size), np.zeros(size), system.solve_w(t, x, live)
        y[:n], y[n : n + len(w)] = x, w
        rate[:n] = np.array(system.ode(t, x, live)).ravel()
        return y, rate


class _Ida:
    """Solutions of a problem by IDA at a relative tolerance, from event to event."""

    def __init__(self, problem: InitialValueProblem, functions: _Functions, rtol: float):
        self._problem, self._f, self._rtol = problem, functions, rtol
        self._atol = absolute(problem, rtol)

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        f, system = self._f, self._problem.system
        x, live, out = system.x0, system.live_start, []
        for piece in self._problem.pieces(times):
            live = self._problem.live(piece.changes, live)
            solver = f.implicit.solver(self._rtol, self._atol, live)
            rows = solved(solver, piece.start, piece.stops, *f.start(system, x, live, piece.start))[:, : f.implicit.n]
            out += list(rows[: len(piece.times)])
            x = rows[-1]
        return CandidateRun(np.array(out))
