"""Peers that take any declaration: SciPy and CasADi on the index-reduced system."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.engine.build.machine_code import compiled
from phfmu.studies.bench.precision.array_function import ArrayFunction, compiled_expression
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, NotAvailable
from phfmu.studies.bench.precision.problem import InitialValueProblem

Array = NDArray[np.float64]

SCIPY = ("DOP853", "LSODA", "Radau")
#: relative tolerances of the reference, and how many times the evaluations of one the next may take
REFERENCE = (1e-10, 1e-11, 1e-12, 2.5e-14)
PATIENCE = 4
#: instructions of x' up to which its derivatives are compiled
LARGE = 4000
#: label -> (kind, options): as it comes; the fastest found for systems without stiffness; stiff; without elimination
CASADI: dict[str, tuple[str, dict[str, Any]]] = {
    "cvodes Adams": ("eliminated", {"linear_multistep_method": "adams"}),
    "cvodes Adams, functional, compiled": (
        "compiled",
        {"linear_multistep_method": "adams", "nonlinear_solver_iteration": "functional"},
    ),
    "cvodes BDF, compiled": ("compiled", {"linear_multistep_method": "bdf"}),
    "idas": ("index 1", {"suppress_algebraic": True}),
}


class ProblemFunctions:
    """The compiled functions of a problem, made when first asked for and shared by all peers."""

    def __init__(self, problem: InitialValueProblem):
        self.problem = problem

    @cached_property
    def rate(self) -> ArrayFunction:
        """(t, x, live) -> x'."""
        ode = self.problem.system.ode
        return ArrayFunction(compiled(ode) if ode.is_a("SXFunction") else ode)

    @cached_property
    def with_derivatives(self) -> ca.Function:
        """The same as a function that CasADi can differentiate; NotAvailable where its derivatives are too large."""
        ode = self.problem.system.ode
        if ode.n_instructions() > LARGE:
            raise NotAvailable(f"x' has {ode.n_instructions()} instructions, its derivatives would compile for minutes")
        return compiled(ode, jacobians=True)

    @cached_property
    def jacobian(self) -> Callable[[float, Array, Array], Array] | None:
        """(t, x, live) -> d x'/dx (n x n) for SciPy's implicit methods; None where there is no closed form of moderate size."""
        s, n = self.problem.system, self.problem.system.x.numel()
        if not s.linear or s.ode.n_instructions() > LARGE:
            return None
        f = compiled_expression("jacobian", s.arguments, ca.jacobian(s.ode(*s.arguments), s.x))
        return lambda t, x, live: f(t, x, live).reshape(n, n, order="F")


def absolute(problem: InitialValueProblem, rtol: float) -> Array:
    """atol = rtol/100 in units of the largest start value of each variable (1 where all are zero)."""
    scale, first = np.ones(problem.system.x.numel()), 0
    for v in problem.declaration.states:
        largest = max(map(abs, v.start))
        scale[first : first + v.n] = largest or 1.0
        first += v.n
    return 1e-2 * rtol * scale


def scipy_candidates(
    problem: InitialValueProblem, tolerances: Sequence[float], functions: ProblemFunctions
) -> Iterator[Candidate]:
    """DOP853, LSODA and Radau on the ordinary differential equation."""
    for method in SCIPY:
        for rtol in tolerances:
            yield Candidate(
                f"SciPy {method}", f"rtol={rtol:g}", rtol, lambda m=method, r=rtol: _Scipy(problem, functions, m, r)
            )


class _Scipy:
    """Solutions of a problem by a method of SciPy at a relative tolerance, from event to event."""

    def __init__(self, problem: InitialValueProblem, functions: ProblemFunctions, method: str, rtol: float):
        self._problem, self._method, self._rtol = problem, method, rtol
        self.rate: Callable[..., Array] = functions.rate
        self._jac = functions.jacobian if method != "DOP853" else None
        self._atol = absolute(problem, rtol)

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        from scipy.integrate import solve_ivp

        system = self._problem.system
        x, live, out = system.x0, system.live_start, []
        for piece in self._problem.pieces(times):
            live = self._problem.live(piece.changes, live)
            jac = self._jac
            extra: dict[str, Any] = {} if jac is None else {"jac": lambda t, y, p=live, j=jac: j(t, y, p)}
            s = solve_ivp(
                lambda t, y, p=live: self.rate(t, y, p), (piece.start, piece.end), x, method=self._method, rtol=self._rtol,
                atol=self._atol, t_eval=piece.stops, **extra,
            )  # fmt: skip
            if not s.success:
                raise RuntimeError(s.message)
            out += [s.y[:, j] for j in range(len(piece.times))]
            x = s.y[:, -1]
        return CandidateRun(np.array(out))


class _StalledSteps(Exception):
    """Rounding of x' keeps the step size small: a tolerance cannot be reached in reasonable time."""


class _CountingRate:
    """A rate that counts its evaluations and raises _Stalled beyond a limit."""

    def __init__(self, rate: Callable[..., Array], limit: float):
        self._rate, self._limit, self.count = rate, limit, 0

    def __call__(self, *args: Any) -> Array:
        self.count += 1
        if self.count > self._limit:
            raise _StalledSteps
        return self._rate(*args)


def solve_reference(problem: InitialValueProblem, functions: ProblemFunctions) -> None:
    """DOP853 at falling relative tolerances, the last that rounding lets it reach; `uncertainty`: distance from the one before.

    At order 8 the next tolerance costs less than twice as much; PATIENCE times is a standstill.
    """
    grid, limit = list(problem.grid), float("inf")
    found: list[Array] = []
    for rtol in REFERENCE:
        solver = _Scipy(problem, functions, "DOP853", rtol)
        solver.rate = rate = _CountingRate(functions.rate, limit)
        try:
            found.append(solver(grid).x)
        except _StalledSteps:
            break
        limit = PATIENCE * rate.count
        problem.reference_name = f"DOP853 rtol {rtol:g} on the reduced system"
    problem.reference = found[-1]
    if len(found) > 1:
        problem.uncertainty = max(problem.distance(a, b) for a, b in zip(*found[-2:], strict=True))


def casadi_candidates(
    problem: InitialValueProblem, tolerances: Sequence[float], functions: ProblemFunctions
) -> Iterator[Candidate]:
    """cvodes with the algebraic variables eliminated, idas on the index-1 form."""
    for label, (kind, options) in CASADI.items():
        for rtol in tolerances:
            yield Candidate(
                f"CasADi {label}", f"rtol={rtol:g}", rtol,
                lambda k=kind, o=options, r=rtol: _Casadi(problem, functions, k, o, r),
            )  # fmt: skip


class _Casadi:
    """One integrator per piece; times inside a piece are output times of one call."""

    def __init__(
        self, problem: InitialValueProblem, functions: ProblemFunctions, kind: str, options: dict[str, Any], rtol: float
    ):
        self._problem = problem
        s = problem.system
        if kind != "index 1" and not s.linear:
            raise NotAvailable("the algebraic rows are not linear in their variables")
        if kind == "compiled":
            args = [ca.MX.sym(n, v.numel()) for n, v in zip("txp", s.arguments, strict=True)]
            self._dae = dict(zip("txp", args, strict=True)) | {"ode": functions.with_derivatives(*args)}
        else:
            self._dae: dict[str, Any] = {"t": s.t, "x": s.x, "p": s.live}
            if kind == "index 1" and s.w.numel():
                self._dae |= {"z": s.w, "ode": s.rate, "alg": s.rows}
            else:
                self._dae["ode"] = s.ode(*s.arguments)
        self._solver = "idas" if kind == "index 1" else "cvodes"
        self._options = {"reltol": rtol, "abstol": 1e-2 * rtol, "max_num_steps": 10_000_000, **options}
        self._made: dict[tuple[float, ...], Any] = {}

    def _integrator(self, start: float, times: Sequence[float]) -> Any:
        key = (start, *times)
        if key not in self._made:
            self._made[key] = ca.integrator("integrator", self._solver, self._dae, start, list(times), self._options)
        return self._made[key]

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        system = self._problem.system
        x, live, out, steps = system.x0, system.live_start, [], 0
        for piece in self._problem.pieces(times):
            live = self._problem.live(piece.changes, live)
            integrator = self._integrator(piece.start, piece.stops.tolist())
            guess = {"z0": system.w0} if "z" in self._dae else {}
            s = integrator(x0=x, p=live, **guess)
            rows = np.array(s["xf"]).T
            out += list(rows[: len(piece.times)])
            x = rows[-1]
            steps += int(integrator.stats().get("nsteps", 0)) if watch else 0
        return CandidateRun(np.array(out), steps or None)
