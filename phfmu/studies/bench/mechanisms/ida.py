"""SUNDIALS IDA on Lagrange's equations in coordinates of joints, stabilised to index 2.

Gear, Gupta, Leimkuhler (J. Comput. Appl. Math. 12, 1985):  p' = v - G^T mu,  M v' = f - G^T lambda,  0 = G v + dg/dt,  0 = g,
y = (p, v, lambda, mu) with the multipliers out of the error test, residual and Jacobian in machine code behind calls of Python.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import casadi as ca
import numpy as np

from phfmu.engine.build.machine_code import compiled
from phfmu.studies.bench.mechanisms.case import MechanismCase
from phfmu.studies.bench.mechanisms.lagrange import Array, Lagrange
from phfmu.studies.bench.precision.buffered_function import BufferedFunction
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, missing


def candidates(case: MechanismCase) -> Iterator[Candidate]:
    if not case.steps.ida:
        return
    if find_spec("sksundae") is None:
        yield missing("SUNDIALS IDA", "not installed; pip install scikit-sundae")
        return
    equations = StabilisedEquations(case.equations)
    for rtol in case.steps.ida:
        yield Candidate("SUNDIALS IDA, GGL", f"rtol={rtol:g}", rtol, lambda r=rtol: _Ida(case, equations, r))


class StabilisedEquations:
    """Residual F(t, y, y') and dF/dy + c dF/dy', compiled; the consistent start."""

    def __init__(self, equations: Lagrange):
        self.of = equations

    @cached_property
    def _made(self) -> tuple[BufferedFunction, BufferedFunction]:
        e = self.of
        m, n = e.g.numel(), e.n
        lam, mu = ca.SX.sym("lambda", m), ca.SX.sym("mu", m)
        y = ca.vertcat(e.p, e.v, lam, mu)
        yp, c = ca.SX.sym("yp", y.numel()), ca.SX.sym("c")
        full = ca.vertcat(
            yp[:n] - e.v + e.slope.T @ mu, e.mass @ yp[n : 2 * n] - e.right + e.slope.T @ lam, e.velocity_row, e.g
        )
        matrix = ca.jacobian(full, y) + c * ca.jacobian(full, yp)
        residual = ca.Function("residual", [e.t, y, yp], [ca.densify(full)])
        return BufferedFunction(compiled(residual)), BufferedFunction(
            compiled(ca.Function("matrix", [e.t, y, yp, c], [ca.densify(matrix)]))
        )

    @property
    def residual(self) -> BufferedFunction:
        return self._made[0]

    @property
    def matrix(self) -> BufferedFunction:
        return self._made[1]

    def start(self) -> tuple[Array, Array]:
        e = self.of
        m, n = e.g.numel(), e.n
        y, yp = np.zeros(2 * (n + m)), np.zeros(2 * (n + m))
        a, lam = e.accelerations(0.0, e.p0, e.v0)
        y[:n], y[n : 2 * n], y[2 * n : 2 * n + m] = e.p0, e.v0, lam
        yp[:n], yp[n : 2 * n] = e.v0, a
        return y, yp


class _Ida:
    def __init__(self, case: MechanismCase, equations: StabilisedEquations, rtol: float):
        IDA: Any = import_module("sksundae.ida").IDA
        self._case, self._e = case, equations
        n, m = equations.of.n, equations.of.g.numel()
        size = 2 * (n + m)
        atol = np.full(size, 1e6)
        atol[: 2 * n] = 1e-2 * rtol
        rate = float(np.abs(equations.of.v0).max(initial=0.0))
        atol[n : 2 * n] *= max(rate, 1.0)
        residual_of, matrix_of = equations.residual, equations.matrix

        def residual(t: float, y: Array, yp: Array, res: Array) -> None:
            res[:] = residual_of(t, y, yp)

        def matrix(t: float, y: Array, yp: Array, res: Array, c: float, jac: Array) -> None:
            jac[:] = matrix_of(t, y, yp, c).reshape(size, size, order="F")

        self._solver = IDA(
            residual, jacfn=matrix, rtol=rtol, atol=atol, algebraic_idx=list(range(2 * n, size)) or None,
            max_num_steps=10_000_000,
        )  # fmt: skip
        self._start = equations.start()

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        found = self._solver.solve(np.array([0.0, *times]), *self._start)
        if not found.success:
            raise RuntimeError(str(found.message))
        e = self._e.of
        rows = np.array([found.y[-1]]) if len(times) == 1 else np.array(found.y[1:])
        points = np.array([e.place(t, y[: e.n]) for t, y in zip(times, rows, strict=True)])
        return CandidateRun(self._case.flat(points))
