"""exudyn on four particles and on pendulum chains: Cartesian coordinates, distance constraints, fixed steps of order 2.

Best practice: mass points, `ConnectorDistance` for bars, spring and damper forces as symbolic user functions (recorded once,
evaluated in C++), the module without range checks, modified Newton at the default tolerance of 1e-8 (1e-7 saves an eighth of
the time and costs digits after 10 s), Eigen's dense matrices below 50 unknowns and its sparse ones above, spectral radius 0.9
(with 1 the multipliers of position constraints oscillate and the constraints drift), no files, no sensors.
"""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib import import_module, metadata
from importlib.util import find_spec
from typing import Any

import numpy as np

from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, missing
from phfmu.studies.bench.precision.problem import InitialValueProblem

STEPS = (0.02, 0.01, 0.005, 0.002, 0.001, 0.0005)
#: the first version with the names of settings used here
OLDEST = (1, 13)
#: unknowns from which on matrices are sparse
SPARSE = 50
ORIGIN = -1


@dataclass(frozen=True)
class Particles:
    """Point masses [kg] with parts between them; the end ORIGIN of a part is fixed at (0, 0, 0).

    bars: (i, j);  springs: (i, j, k [N/m3]) with V = k/2 (|d|^2 - 1)^2;  dampers: (i, j, eta0 [N.s/m], alpha [1/m2]) with the
    force eta0 (1 + alpha |d|^2) d';  fresh: a Jacobian each step, where fewer iterations save more than it costs.
    """

    masses: tuple[float, ...]
    bars: tuple[tuple[int, int], ...]
    springs: tuple[tuple[int, int, float], ...] = ()
    dampers: tuple[tuple[int, int, float, float], ...] = ()
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fresh: bool = False
    dim: int = 3

    @property
    def unknowns(self) -> int:
        return self.dim * len(self.masses) + len(self.bars)


def particles(problem: InitialValueProblem) -> Particles | None:
    """The parts of a target this file knows, numbers from its declaration; None for all others."""
    values = {v.name: v.start for v in problem.declaration.parameters}
    if problem.name == "four_particle":
        springs = ((0, 2, values["k13"][0]), (1, 3, values["k24"][0]))
        damper = (1, 2, values["eta0"][0], values["alpha"][0])
        return Particles(values["m"], ((0, 1), (2, 3)), springs, (damper,))
    if re.fullmatch(r"chain_\d+", problem.name):
        n = len(values["m"])
        bars = tuple((i - 1 if i else ORIGIN, i) for i in range(n))
        return Particles(values["m"], bars, gravity=(0.0, -9.81, 0.0), fresh=True, dim=2)
    return None


def candidates(problem: InitialValueProblem) -> Iterator[Candidate]:
    """Generalized-alpha on constrained positions (index 3), the trapezoidal rule on constrained velocities (index 2)."""
    known = particles(problem)
    if known is None:
        return
    if why := obstacle():
        yield missing("exudyn", why)
        return
    for label, trapezoidal in (("generalized-alpha", False), ("trapezoidal index 2", True)):
        for h in STEPS:
            yield Candidate(
                f"exudyn {label}", f"h={h:g}", h, lambda p=known, x=trapezoidal, h=h: _Exudyn(problem, p, x, h)
            )


def obstacle() -> str:
    """Why exudyn cannot be used, with the remedy; empty if it can."""
    if find_spec("exudyn") is None:
        return "not installed; pip install exudyn"
    version = metadata.version("exudyn")
    if tuple(map(int, version.split(".")[:2])) < OLDEST:
        return f"version {version} is older than {'.'.join(map(str, OLDEST))}; pip install -U exudyn"
    return ""


def library() -> Any:
    """The module without range checks, quiet."""
    sys.exudynFast = True  # type: ignore[attr-defined]  # read once, at import
    with redirect_stdout(io.StringIO()):
        found: Any = import_module("exudyn")
    found.config.printToConsole = False
    return found


def fixed_steps(library: Any, end: float, h: float) -> Any:
    """Settings of a run with equal steps up to `end` [s], without files."""
    settings = library.SimulationSettings()
    run = settings.timeIntegration
    run.endTime, run.numberOfSteps, run.adaptiveStep, run.verboseMode = end, round(end / h), False, 0
    settings.solution.file.write = False
    return settings


def implicit(settings: Any, library: Any, trapezoidal: bool, unknowns: int, fresh: bool) -> None:
    """Generalized-alpha on positions, or the trapezoidal rule on velocities; `fresh`: a new Jacobian each step."""
    run, kinds = settings.timeIntegration, library.LinearSolverType
    run.newton.useModifiedNewton = True
    run.newton.modifiedNewtonJacUpdatePerStep = fresh
    run.generalizedAlpha.spectralRadius = 0.9
    run.generalizedAlpha.useNewmark = run.generalizedAlpha.useIndex2Constraints = trapezoidal
    settings.linearSolver.solverType = kinds.EigenDense if unknowns < SPARSE else kinds.EigenSparse


class _System:
    """An assembled model; exudyn wants containers and symbolic functions kept for as long as it lives."""

    def __init__(self, library: Any, particles: Particles, x0: np.ndarray):
        self._items: Any = import_module("exudyn.itemInterface")
        self._symbolic: Any = import_module("exudyn.utilities").CreateSymbolicUserFunction
        self._kept: list[Any] = [library.SystemContainer()]
        self.mbs: Any = self._kept[0].AddSystem()
        self.q0, v0 = np.split(x0, 2)
        shape = (len(particles.masses), particles.dim)
        self._points(particles, self.q0.reshape(shape), v0.reshape(shape))
        for i, j in particles.bars:
            length = float(np.linalg.norm(self._place[j] - self._place[i]))
            self.mbs.AddObject(self._items.ObjectConnectorDistance(markerNumbers=self._ends(i, j), distance=length))
        for part in particles.springs:
            self._spring(*part)
        for part in particles.dampers:
            self._damper(*part)
        self.mbs.Assemble()

    def _points(self, particles: Particles, q: np.ndarray, v: np.ndarray) -> None:
        make, mbs = self._items, self.mbs
        bodies, plane = [mbs.AddObject(make.ObjectGround())], "2D" if particles.dim == 2 else ""
        point, body = getattr(make, f"NodePoint{plane}"), getattr(make, f"ObjectMassPoint{plane}")
        for mass, place, velocity in zip(particles.masses, q, v, strict=True):
            node = mbs.AddNode(point(referenceCoordinates=list(place), initialVelocities=list(velocity)))
            bodies.append(mbs.AddObject(body(mass=mass, nodeNumber=node)))
        self._place = np.vstack([q, np.zeros(particles.dim)])  # ORIGIN is the last one of places and of markers
        self._markers = [mbs.AddMarker(make.MarkerBodyPosition(bodyNumber=b)) for b in (*bodies[1:], bodies[0])]
        if any(particles.gravity):
            for mass, marker in zip(particles.masses, self._markers, strict=False):
                weight = [mass * g for g in particles.gravity]
                mbs.AddLoad(make.LoadForceVector(markerNumber=marker, loadVector=weight))

    def _ends(self, i: int, j: int) -> list[Any]:
        return [self._markers[i], self._markers[j]]

    def _force(self, kind: str, law: Any) -> Any:
        """A force law recorded as an expression of C++."""
        function = self._symbolic(self.mbs, law, "springForceUserFunction", itemTypeName=kind)
        self._kept.append(function)
        return function

    def _spring(self, i: int, j: int, k: float) -> None:
        def tension(mbs, t, item, length, rate, stiffness, damping, force):
            return 2.0 * stiffness * length * (length * length - 1.0)

        kind = "ObjectConnectorSpringDamper"
        law = self._force(kind, tension)
        make = getattr(self._items, kind)
        self.mbs.AddObject(make(markerNumbers=self._ends(i, j), stiffness=k, springForceUserFunction=law))

    def _damper(self, i: int, j: int, eta0: float, alpha: float) -> None:
        def force(mbs, t, item, d, rate, stiffness, damping, offset):
            eta = eta0 * (1.0 + alpha * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]))
            return [eta * rate[0], eta * rate[1], eta * rate[2]]

        kind = "ObjectConnectorCartesianSpringDamper"
        law = self._force(kind, force)
        self.mbs.AddObject(getattr(self._items, kind)(markerNumbers=self._ends(i, j), springForceUserFunction=law))

    def state(self) -> np.ndarray:
        """Positions and velocities as the declaration orders them; exudyn's coordinates are displacements."""
        data = self.mbs.systemData
        return np.concatenate([self.q0 + data.GetODE2Coordinates(), data.GetODE2Coordinates_t()])


class _Exudyn:
    """A solver per time asked for: its steps end there, and every run starts at zero."""

    def __init__(self, problem: InitialValueProblem, particles: Particles, trapezoidal: bool, h: float):
        problem.require_step(h)
        self._lib, self._particles, self._trapezoidal, self._h = library(), particles, trapezoidal, h
        self._system = _System(self._lib, particles, problem.system.x0)
        self._made = {float(t): self._solver(float(t)) for t in problem.grid}

    def _solver(self, end: float) -> tuple[Any, Any]:
        settings, solver = fixed_steps(self._lib, end, self._h), self._lib.MainSolverImplicitSecondOrder()
        implicit(settings, self._lib, self._trapezoidal, self._particles.unknowns, self._particles.fresh)
        solver.InitializeSolver(self._system.mbs, settings)
        return solver, settings

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        rows, iterations = [], 0
        for t in times:
            solver, settings = self._made[float(t)]
            before = solver.it.newtonStepsCount
            solver.InitializeSolverInitialConditions(self._system.mbs, settings)
            if not solver.SolveSteps(self._system.mbs, settings):
                raise RuntimeError(f"no convergence at t = {solver.it.currentTime:g} s")
            rows.append(self._system.state())
            iterations = solver.it.newtonStepsCount - before
        return CandidateRun(np.array(rows), round(float(max(times)) / self._h), iterations if watch else None)
