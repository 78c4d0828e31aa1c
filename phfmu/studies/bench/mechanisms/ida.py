"""SUNDIALS IDA on Lagrange's equations in coordinates of joints, stabilised to index 2.

Gear, Gupta, Leimkuhler (J. Comput. Appl. Math. 12, 1985):  p' = v - G^T mu,  M v' = f - G^T lambda,  0 = G v + dg/dt,  0 = g,
y = (p, v, lambda, mu) with the multipliers out of the error test, residual and Jacobian in machine code behind calls of Python.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from phfmu.studies.bench.mechanisms.case import MechanismCase
from phfmu.studies.bench.mechanisms.lagrange import Array, Lagrange
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun
from phfmu.studies.bench.precision.sundae import ImplicitSystem, missing_ida, solved


def candidates(case: MechanismCase) -> Iterator[Candidate]:
    if not case.steps.ida:
        return
    if remark := [*missing_ida()]:
        yield from remark
        return
    equations = StabilisedEquations(case.equations)
    for rtol in case.steps.ida:
        yield Candidate("SUNDIALS IDA, GGL", f"rtol={rtol:g}", rtol, lambda r=rtol: _IdaMechanism(case, equations, r))


class StabilisedEquations:
    """Lagrange's equations with both levels of constraints, compiled when first asked for; the consistent start."""

    def __init__(self, equations: Lagrange):
        self.of = equations

    @cached_property
    def implicit(self) -> ImplicitSystem:
        e = self.of
        m, n = e.g.numel(), e.n
        lam, mu = ca.SX.sym("lambda", m), ca.SX.sym("mu", m)
        y = ca.vertcat(e.p, e.v, lam, mu)
        yp = ca.SX.sym("yp", y.numel())
        full = ca.vertcat(
            yp[:n] - e.v + e.slope.T @ mu, e.mass @ yp[n : 2 * n] - e.right + e.slope.T @ lam, e.velocity_row, e.g
        )
        return ImplicitSystem(e.t, y, yp, full, 2 * n)

    def start(self) -> tuple[Array, Array]:
        e = self.of
        m, n = e.g.numel(), e.n
        y, yp = np.zeros(2 * (n + m)), np.zeros(2 * (n + m))
        a, lam = e.accelerations(0.0, e.p0, e.v0)
        y[:n], y[n : 2 * n], y[2 * n : 2 * n + m] = e.p0, e.v0, lam
        yp[:n], yp[n : 2 * n] = e.v0, a
        return y, yp


class _IdaMechanism:
    """IDA made once, whose runs give the points of a mechanism."""

    def __init__(self, case: MechanismCase, equations: StabilisedEquations, rtol: float):
        self._case, self._e = case, equations
        n, rate = equations.of.n, float(np.abs(equations.of.v0).max(initial=0.0))
        atol = np.full(2 * n, 1e-2 * rtol)
        atol[n:] *= max(rate, 1.0)
        self._solver, self._start = equations.implicit.solver(rtol, atol), equations.start()

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        rows, e = solved(self._solver, 0.0, times, *self._start), self._e.of
        points = np.array([e.place(t, y[: e.n]) for t, y in zip(times, rows, strict=True)])
        return CandidateRun(self._case.flat(points))
