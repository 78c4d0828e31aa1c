"""MuJoCo on any assembly: joint coordinates for the tree, soft equality constraints for loops, RK4.

Best practice: no contacts; RK4 is the most accurate integrator it has; where nothing closes a loop constraints are off, and
nothing can drift.  Loops are held by `connect` constraints, which MuJoCo solves as stiff springs and dampers; their time
constant may not be below two steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from phfmu.studies.bench.mechanisms.assembly import GROUND, Array, BodyJoint, RigidBodySystem
from phfmu.studies.bench.mechanisms.case import MechanismCase
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, missing

#: moment [kg.m2] that thin rods and point masses get, which MuJoCo wants positive
LEAST = 1e-12
KINDS = {"revolute": "hinge", "spherical": "ball", "prismatic": "slide"}


def candidates(case: MechanismCase) -> Iterator[Candidate]:
    if case.assembly is None or not case.steps.mujoco:
        return
    if find_spec("mujoco") is None:
        yield missing("MuJoCo", "not installed; pip install mujoco")
        return
    for h in case.steps.mujoco:
        yield Candidate("MuJoCo RK4", f"h={h:g}", h, lambda h=h: MuJoCo(case, h))


def xml(assembly: RigidBodySystem, h: float) -> str:
    """An MJCF whose bodies have the axes of the world at the start, where all joint coordinates are zero."""
    loops = "".join(_equality(assembly, link, h) for link in assembly.loops)
    off = "" if loops else ' constraint="disable"'
    tendons, sites = _tendons(assembly)
    return (
        f'<mujoco><option timestep="{h!r}" integrator="RK4" gravity="{_words(assembly.gravity)}">'
        f'<flag contact="disable"{off}/></option><worldbody>{sites.get(GROUND, "")}'
        f"{_bodies(assembly, GROUND, np.zeros(3), sites)}</worldbody>{tendons}"
        f"{f'<equality>{loops}</equality>' if loops else ''}</mujoco>"
    )


def _words(values: Array) -> str:
    return " ".join(repr(float(v)) for v in values)


def _bodies(assembly: RigidBodySystem, parent: int, origin: Array, sites: dict[int, str]) -> str:
    """Bodies that hang on a parent; the origin of each is at its joint."""
    out = ""
    for link in assembly.tree:
        if link.a != parent:
            continue
        b, i = assembly.bodies[link.b], link.b
        inertia = b.inertia if np.linalg.eigvalsh(b.inertia)[0] > LEAST else b.inertia + LEAST * np.eye(3)
        six = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        damping = f' damping="{link.damping!r}"' if link.damping else ""
        out += (
            f'<body name="b{i}" pos="{_words(link.at - origin)}">'
            f'<joint name="j{i}" type="{KINDS[link.kind]}" axis="{_words(link.axis)}"{damping}/>'
            f'<inertial pos="{_words(b.centre - link.at)}" mass="{b.mass!r}" fullinertia="{_words(six)}"/>'
            f"{sites.get(i, '')}{_bodies(assembly, i, link.at, sites)}</body>"
        )
    return out


def origins(assembly: RigidBodySystem) -> dict[int, Array]:
    """Origins of the frames of the bodies at the start [m]."""
    return {GROUND: np.zeros(3), **{link.b: link.at for link in assembly.tree}}


def anchors(assembly: RigidBodySystem, link: BodyJoint) -> list[Array]:
    """The points that hold a loop together: one of a ball, or in the plane; two along the axis of a hinge in space."""
    along = (0.0,) if assembly.planar or link.kind == "spherical" else (-0.5, 0.5)
    return [link.at + s * link.axis for s in along]


def _equality(assembly: RigidBodySystem, link: BodyJoint, h: float) -> str:
    """A loop as soft constraints of its anchors."""
    where = origins(assembly)
    first, second = (("world" if i == GROUND else f"b{i}") for i in (link.a, link.b))
    if link.a == GROUND:
        first, second, base = second, first, where[link.b]
    else:
        base = where[link.a]
    soft = f'solref="{2 * h!r} 1" solimp="0.9999 0.9999 0.001"'
    return "".join(
        f'<connect body1="{first}" body2="{second}" anchor="{_words(at - base)}" {soft}/>'
        for at in anchors(assembly, link)
    )


def _tendons(assembly: RigidBodySystem) -> tuple[str, dict[int, str]]:
    """Springs as spatial tendons between sites."""
    where, sites, tendons = origins(assembly), dict[int, str](), ""
    for n, s in enumerate(assembly.struts):
        for end, i, at in (("a", s.a, s.at_a), ("b", s.b, s.at_b)):
            sites[i] = sites.get(i, "") + f'<site name="s{n}{end}" pos="{_words(at - where[i])}"/>'
        tendons += (
            f'<spatial stiffness="{s.stiffness!r}" springlength="{s.length!r}">'
            f'<site site="s{n}a"/><site site="s{n}b"/></spatial>'
        )
    return (f"<tendon>{tendons}</tendon>" if tendons else ""), sites


class MuJoCo:
    """An assembly stepped by RK4; gives the points at the times, which are multiples of the step."""

    def __init__(self, case: MechanismCase, h: float):
        assert case.assembly is not None
        mujoco: Any = import_module("mujoco")
        self._lib, self._h, self._case, self._assembly = mujoco, h, case, case.assembly
        self._model: Any = mujoco.MjModel.from_xml_string(xml(case.assembly, h))
        self._data: Any = mujoco.MjData(self._model)
        self._start = np.zeros(self._model.nv)
        self._torque = np.zeros(self._model.nv)
        for link in self._assembly.tree:
            first = int(self._model.joint(f"j{link.b}").dofadr[0])
            rate = self._assembly.rate(link)
            n = 3 if link.kind == "spherical" else 1
            self._start[first : first + n] = rate if n == 3 else link.axis @ rate
            self._torque[first] = link.torque
        where = origins(self._assembly)
        self._points = [(self._model.body(f"b{i}").id, x - where[i]) for i, x in self._assembly.points]

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        lib, data = self._lib, self._data
        lib.mj_resetData(self._model, data)
        data.qvel[:], data.qfrc_applied[:] = self._start, self._torque
        done, rows = 0, []
        for t in times:
            n = round(t / self._h)
            lib.mj_step(self._model, data, nstep=n - done)
            done = n
            lib.mj_kinematics(self._model, data)
            rows.append(np.concatenate([data.xpos[i] + data.xmat[i].reshape(3, 3) @ x for i, x in self._points]))
        return CandidateRun(self._case.flat(np.array(rows)), done)
