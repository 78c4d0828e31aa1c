"""exudyn on any assembly: bodies with constraints by implicit rules of order 2, and the tree of joints by explicit methods.

Best practice: bodies in Euler parameters, in the plane its own bodies in the plane, modified Newton, the module without
range checks, dense matrices below 50 unknowns; where no loop is closed also its kinematic tree in joint coordinates, without
constraints, by Runge-Kutta methods with step control (Dormand-Prince of order 5) and without (order 6); a ball is three hinges
with two massless links, which is singular a quarter turn away from the start.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from phfmu.studies.bench.mechanisms.assembly import GROUND, Array, BodyJoint, RigidBodySystem, frame_along
from phfmu.studies.bench.mechanisms.case import MechanismCase
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, missing
from phfmu.studies.bench.precision.exudyn_particles import fixed_steps, implicit, library, obstacle


def candidates(case: MechanismCase) -> Iterator[Candidate]:
    if case.assembly is None:
        return
    if why := obstacle():
        yield missing("exudyn", why)
        return
    for label, trapezoidal in (("generalized-alpha", False), ("trapezoidal index 2", True)):
        for h in case.steps.exudyn:
            yield Candidate(f"exudyn {label}", f"h={h:g}", h, lambda x=trapezoidal, h=h: _bodies(case, x, h))
    if case.assembly.loops or case.assembly.struts:
        return
    for h in case.steps.exudyn_tree:
        yield Candidate("exudyn tree RK67", f"h={h:g}", h, lambda h=h: _tree(case, "RK67", h))
    for rtol in case.steps.tolerances if case.steps.exudyn_tree else ():
        yield Candidate("exudyn tree DOPRI5", f"rtol={rtol:g}", rtol, lambda r=rtol: _tree(case, "DOPRI5", r))


class Exudyn:
    """A system and its solver, made once; `places` reads the points off."""

    def __init__(
        self, case: MechanismCase, mbs: Any, kept: Any, places: Callable[[], list[Array]], settings: Any, solver: Any
    ):
        self._case, self.mbs, self._kept, self._places = case, mbs, kept, places
        self._settings, self._solver = settings, solver
        solver.InitializeSolver(mbs, settings)

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        if list(times) != [self._case.stop]:
            raise ValueError(f"exudyn is prepared for t = {self._case.stop:g} s")
        self._solver.InitializeSolverInitialConditions(self.mbs, self._settings)
        if not self._solver.SolveSteps(self.mbs, self._settings):
            raise RuntimeError(f"no convergence at t = {self._solver.it.currentTime:g} s")
        steps = int(self._solver.it.currentStepIndex)
        return CandidateRun(self._case.flat(np.concatenate(self._places())[None]), steps)


def _bodies(case: MechanismCase, trapezoidal: bool, h: float) -> Exudyn:
    """Rigid bodies in Euler parameters, or in the plane, with a constraint for each link."""
    lib, assembly = library(), case.assembly
    assert assembly is not None
    made = _Bodies(lib, assembly)
    settings = fixed_steps(lib, case.stop, h)
    implicit(settings, lib, trapezoidal, made.unknowns, True)
    return Exudyn(case, made.mbs, made, made.places, settings, lib.MainSolverImplicitSecondOrder())


class _Bodies:
    """An assembly of bodies; all frames have the axes of the world at the start and their origin in the centre of mass."""

    def __init__(self, lib: Any, assembly: RigidBodySystem):
        self._lib, self._items, self._assembly = lib, import_module("exudyn.itemInterface"), assembly
        inertia = import_module("exudyn.rigidBodyUtilities").RigidBodyInertia
        self._container: Any = lib.SystemContainer()
        self.mbs: Any = self._container.AddSystem()
        self._numbers = {GROUND: self.mbs.CreateGround()}
        for i, b in enumerate(assembly.bodies):
            self._numbers[i] = self.mbs.CreateRigidBody(
                referencePosition=b.centre.tolist(), initialVelocity=b.velocity.tolist(), create2D=assembly.planar,
                initialAngularVelocity=b.spin.tolist(), gravity=assembly.gravity.tolist(),
                inertia=inertia(mass=b.mass, inertiaTensor=b.inertia),
            )  # fmt: skip
        rows = {"revolute": 5, "spherical": 3, "prismatic": 5}
        self.unknowns = sum(2 if assembly.planar else rows[link.kind] for link in assembly.links)
        self.unknowns += len(assembly.bodies) * (3 if assembly.planar else 8)
        for link in assembly.links:
            self._join(link)
        for s in assembly.struts:
            self.mbs.CreateSpringDamper(
                itemNumbers=[self._numbers[s.a], self._numbers[s.b]], localPosition0=self._local(s.a, s.at_a),
                localPosition1=self._local(s.b, s.at_b), referenceLength=s.length, stiffness=s.stiffness,
            )  # fmt: skip
        self.mbs.Assemble()

    def _local(self, body: int, at: Array) -> list[float]:
        return (at if body == GROUND else at - self._assembly.bodies[body].centre).tolist()

    def _join(self, link: BodyJoint) -> None:
        pair = [self._numbers[link.a], self._numbers[link.b]]
        if self._assembly.planar:
            self._join_in_plane(link, pair)
        elif link.kind == "spherical":
            self.mbs.CreateSphericalJoint(itemNumbers=pair, position=link.at.tolist())
        elif link.spare:
            rows, frame = [1, 1, 1, 1, 0, 0], frame_along(link.axis)
            self.mbs.CreateGenericJoint(
                itemNumbers=pair, position=link.at.tolist(), rotationMatrixAxes=frame, constrainedAxes=rows
            )
        else:
            create = self.mbs.CreateRevoluteJoint if link.kind == "revolute" else self.mbs.CreatePrismaticJoint
            create(itemNumbers=pair, position=link.at.tolist(), axis=link.axis.tolist())
        if link.damping:
            self.mbs.CreateTorsionalSpringDamper(
                itemNumbers=pair, position=link.at.tolist(), axis=link.axis.tolist(), damping=link.damping
            )
        if link.torque:
            self.mbs.CreateTorque(itemNumber=pair[1], loadVector=(link.torque * link.axis).tolist())

    def _join_in_plane(self, link: BodyJoint, pair: list[Any]) -> None:
        markers = [
            self.mbs.AddMarker(self._items.MarkerBodyRigid(bodyNumber=n, localPosition=self._local(i, link.at)))
            for n, i in zip(pair, (link.a, link.b), strict=True)
        ]
        if link.kind == "revolute":
            self.mbs.AddObject(self._items.ObjectJointRevolute2D(markerNumbers=markers))
        else:
            normal = np.cross((0.0, 0.0, 1.0), link.axis).tolist()
            joint = self._items.ObjectJointPrismatic2D
            self.mbs.AddObject(joint(markerNumbers=markers, axisMarker0=link.axis.tolist(), normalMarker1=normal))

    def places(self) -> list[Array]:
        position = self._lib.OutputVariableType.Position
        return [
            np.array(self.mbs.GetObjectOutputBody(self._numbers[i], position, localPosition=self._local(i, x)))
            for i, x in self._assembly.points
        ]


def _tree(case: MechanismCase, method: str, setting: float) -> Exudyn:
    """The tree of joints by an explicit method; setting: a step [s], or a relative tolerance for one with step control."""
    lib, assembly = library(), case.assembly
    assert assembly is not None
    made = _KinematicTree(lib, assembly)
    controlled = method == "DOPRI5"
    settings = fixed_steps(lib, case.stop, case.steps.exudyn_tree[0] if controlled else setting)
    run, solver = settings.timeIntegration, lib.MainSolverExplicit()
    run.solverType = getattr(lib.DynamicSolverType, method)
    run.explicit.useLieGroupIntegration = False
    if controlled:
        run.numberOfSteps, run.automaticStepSize = 1, True
        run.relativeTolerance, run.absoluteTolerance = setting, 1e-2 * setting
        run.initialStepSize = 1e-3 * case.stop
    return Exudyn(case, made.mbs, made, made.places, settings, solver)


class _KinematicTree:
    """Links whose frames have the axis of their joint for z; a ball is three hinges about x, y, z."""

    def __init__(self, lib: Any, assembly: RigidBodySystem):
        self._lib, self._assembly = lib, assembly
        utilities = import_module("exudyn.rigidBodyUtilities")
        self._container: Any = lib.SystemContainer()
        self.mbs: Any = self._container.AddSystem()
        links, rates, frames, number = [], list[float](), {GROUND: (np.eye(3), np.zeros(3))}, {GROUND: -1}
        for link in assembly.tree:
            b, rate = assembly.bodies[link.b], assembly.rate(link)
            axes = np.eye(3) if link.kind == "spherical" else link.axis[None]
            for last, axis in ((k == len(axes) - 1, x) for k, x in enumerate(axes)):
                before, origin = frames[link.a] if number.get(link.b) is None else frames[link.b]
                parent = number.get(link.b, number[link.a])
                own = frame_along(axis)
                transform = np.eye(4)
                transform[:3, :3], transform[:3, 3] = before.T @ own, before.T @ (link.at - origin)
                inertia = utilities.RigidBodyInertia(
                    mass=b.mass if last else 0.0, com=own.T @ (b.centre - link.at) if last else np.zeros(3),
                    inertiaTensor=own.T @ b.inertia @ own if last else np.zeros((3, 3)), inertiaTensorAtCOM=True,
                )  # fmt: skip
                kind = lib.JointType.PrismaticZ if link.kind == "prismatic" else lib.JointType.RevoluteZ
                links.append(utilities.TreeLink(inertia, kind, transform, parent, graphicsDataList=[]))
                rates.append(float(axis @ rate))
                frames[link.b], number[link.b] = (own, link.at), len(links) - 1
        self._frames, self._number = frames, number
        self._tree = self.mbs.CreateKinematicTree(
            listOfTreeLinks=links, referenceCoordinates=[0.0] * len(links), initialCoordinates_t=rates,
            gravity=assembly.gravity.tolist(),
        )  # fmt: skip
        sensor = import_module("exudyn.itemInterface").SensorKinematicTree
        self._sensors = []
        for i, x in assembly.points:
            turn, origin = frames[i]
            place = (turn.T @ (x - origin)).tolist()
            made = sensor(
                objectNumber=self._tree, linkNumber=number[i], localPosition=place, writeToFile=False,
                outputVariableType=lib.OutputVariableType.Position,
            )  # fmt: skip
            self._sensors.append(self.mbs.AddSensor(made))
        self.mbs.Assemble()

    def places(self) -> list[Array]:
        return [np.array(self.mbs.GetSensorValues(s)) for s in self._sensors]
