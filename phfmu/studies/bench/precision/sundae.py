"""SUNDIALS IDA through scikit-sundae, on the stabilised index-2 form of holonomic models.

Gear, Gupta, Leimkuhler (J. Comput. Appl. Math. 12, 1985):  q' = v - Dg^T mu,  M v' = f - Dg^T lambda,  0 = g,  0 = Dg v,
y = (x, w, mu) with the multipliers out of the error test (absolute tolerance 1e6), the Jacobian analytic, y and y' consistent.
Models without constraints: the index-1 form.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.engine.build.machine_code import compiled
from phfmu.studies.bench.precision.buffered_function import BufferedFunction
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, missing
from phfmu.studies.bench.precision.peers import absolute
from phfmu.studies.bench.precision.problem import InitialValueProblem
from phfmu.studies.bench.precision.reduced import ReducedSystem, stabilised

Array = NDArray[np.float64]


def candidates(problem: InitialValueProblem, tolerances: Sequence[float]) -> Iterator[Candidate]:
    if find_spec("sksundae") is None:
        yield missing("SUNDIALS IDA", "not installed; pip install scikit-sundae")
        return
    made: list[_Functions] = []

    def functions() -> _Functions:
        if not made:
            made.append(_Functions(problem))
        return made[0]

    for rtol in tolerances:
        yield Candidate("SUNDIALS IDA, GGL", f"rtol={rtol:g}", rtol, lambda r=rtol: _Ida(problem, functions(), r))


class _Functions:
    """Residual F(t, y, y', live) and dF/dy + c dF/dy', compiled; the start."""

    def __init__(self, problem: InitialValueProblem):
        system = problem.system
        self.n = system.x.numel()
        y, residual = stabilised(system)
        yp, c = ca.SX.sym("yp", y.numel()), ca.SX.sym("c")
        full = ca.vertcat(yp[: self.n], ca.SX.zeros(y.numel() - self.n)) - residual
        matrix = ca.jacobian(full, y) + c * ca.jacobian(full, yp)
        args = [system.t, y, yp, system.live]
        self.residual = BufferedFunction(compiled(ca.Function("residual", args, [full])))
        self.matrix = BufferedFunction(compiled(ca.Function("matrix", [*args, c], [ca.densify(matrix)])))
        self.size = y.numel()

    def callbacks(self, live: Array) -> tuple[Callable[..., None], Callable[..., None]]:
        """Residual and Jacobian as IDA calls them."""

        def residual(t, y, yp, res):
            res[:] = self.residual(t, y, yp, live)

        def matrix(t, y, yp, res, c, jac):
            jac[:] = self.matrix(t, y, yp, live, c).reshape(self.size, self.size, order="F")

        return residual, matrix

    def start(self, system: ReducedSystem, x: Array, live: Array, t: float) -> tuple[Array, Array]:
        """Consistent y and y' at a state on the constraints (mu = 0)."""
        y, rate, w = np.zeros(self.size), np.zeros(self.size), system.solve_w(t, x, live)
        y[: self.n], y[self.n : self.n + len(w)] = x, w
        rate[: self.n] = np.array(system.ode(t, x, live)).ravel()
        return y, rate


class _Ida:
    def __init__(self, problem: InitialValueProblem, functions: _Functions, rtol: float):
        self._problem, self._f, self._rtol = problem, functions, rtol
        self._atol = np.full(functions.size, 1e6)
        self._atol[: functions.n] = absolute(problem, rtol)

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        IDA: Any = import_module("sksundae.ida").IDA
        f, system = self._f, self._problem.system
        x, live, out = system.x0, system.live_start, []
        for piece in self._problem.pieces(times):
            live = self._problem.live(piece.changes, live)

            residual, matrix = f.callbacks(live)
            solver = IDA(
                residual, jacfn=matrix, rtol=self._rtol, atol=self._atol, algebraic_idx=list(range(f.n, f.size)) or None,
                max_num_steps=10_000_000,
            )  # fmt: skip
            found = solver.solve(np.array([piece.start, *piece.stops]), *f.start(system, x, live, piece.start))
            if not found.success:
                raise RuntimeError(str(found.message))
            # with one interval the solver returns all of its own steps
            rows = (found.y[1:] if len(piece.stops) > 1 else found.y[-1:])[:, : f.n]
            out += list(rows[: len(piece.times)])
            x = rows[-1]
        return CandidateRun(np.array(out))
