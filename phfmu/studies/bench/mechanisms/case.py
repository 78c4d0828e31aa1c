"""A mechanism with a reference in other coordinates, and the schemes of this package on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import time
from phfmu.network.scene import Scene
from phfmu.studies.bench.mechanisms.assembly import Array, RigidBodySystem
from phfmu.studies.bench.mechanisms.lagrange import Lagrange, lagrange_of
from phfmu.studies.bench.precision import own
from phfmu.studies.bench.precision.array_function import compiled_expression
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, Solve
from phfmu.studies.bench.precision.problem import SolutionErrors, problem_of

#: schemes by order; with holonomic constraints there is none of order 4
SCHEMES = {2: "two-level:2", 6: "two-level:6"}


@dataclass(frozen=True)
class StepSettings:
    """Settings of a case: steps [s] by order of ours, of MuJoCo and exudyn; accuracies of what controls its steps."""

    own: dict[int, tuple[float, ...]]
    mujoco: tuple[float, ...] = ()
    exudyn: tuple[float, ...] = ()
    exudyn_tree: tuple[float, ...] = ()
    tolerances: tuple[float, ...] = ()
    ida: tuple[float, ...] = ()
    opensim: tuple[float, ...] = ()


@dataclass(eq=False)
class MechanismCase:
    """A declaration and the same mechanism as numbers; errors are the largest distance [m] of a coordinate of the points.

    observed: observables of the declaration that are the points, in their order;  assembly: None where it is no rigid bodies
    lagrange: the equations that the reference solves (default: those of the assembly)
    """

    name: str
    declared: Callable[[], PHDAE]
    observed: tuple[str, ...]
    stop: float
    steps: StepSettings
    assembly: RigidBodySystem | None = None
    lagrange: Lagrange | None = None
    judged: tuple[str, ...] = ("positions",)
    reference: Array = field(default_factory=lambda: np.zeros((0, 0)))
    uncertainty: float = float("nan")

    @property
    def times(self) -> tuple[float, ...]:
        return (self.stop,)

    @property
    def grid(self) -> Array:
        return np.array([self.stop])

    @cached_property
    def declaration(self) -> PHDAE:
        return self.declared()

    @cached_property
    def equations(self) -> Lagrange:
        """Lagrange's equations in coordinates of joints."""
        if self.lagrange is not None:
            return self.lagrange
        assert self.assembly is not None, self.name
        return lagrange_of(self.assembly)

    def flat(self, points: Array) -> Array:
        """Points in space as they are compared: in the plane without z."""
        if self.assembly is None or not self.assembly.planar:
            return points
        return points.reshape(len(points), -1, 3)[:, :, :2].reshape(len(points), -1)

    def solve_reference(self) -> None:
        found, self.uncertainty = self.equations.reference([self.stop])
        self.reference = self.flat(found)

    def judge(self, x: Array) -> SolutionErrors:
        """`x`: points at the stop time, flat."""
        return SolutionErrors((float(np.abs(x[-1] - self.reference[-1]).max()),), float("nan"), float("nan"))

    @cached_property
    def _place(self) -> Callable[[float, Array], Array]:
        """(t, x) -> points, from the observables of the declaration."""
        d = self.declaration
        known = {o.name: o.expr for o in d.observables}
        points = ca.vertcat(*(ca.vec(known[name]) for name in self.observed))
        held = d.parameters
        if held:
            values = ca.vertcat(*(ca.DM(v.start) for v in held))
            points = ca.substitute(points, ca.veccat(*(v.sx for v in held)), ca.SX(values))
        return compiled_expression("points", [time, ca.veccat(*(v.sx for v in d.states))], points)

    def own(self) -> Iterator[Candidate]:
        """The schemes at each step, observed at the points."""
        problem = problem_of(Scene(self.name, self.declaration, self.stop, self.stop), times=self.times)
        for order, steps in self.steps.own.items():
            for c in own.candidates(problem, [SCHEMES[order]], ["native"], steps):
                yield Candidate(f"phfmu, order {order}", c.setting, c.value, lambda c=c: self._observed(c), own=True)

    def _observed(self, candidate: Candidate) -> Solve:
        solve = candidate.prepare()

        def observed(times: Sequence[float], watch: bool = False) -> CandidateRun:
            run = solve(times, watch)
            points = np.array([self._place(t, x) for t, x in zip(times, run.x, strict=True)])
            return CandidateRun(points, run.steps, run.iterations, run.ledger)

        return observed
