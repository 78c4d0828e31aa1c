"""Mechanisms in MJCF and URDF, read by MuJoCo: bodies, joints, loops, motors, and what a mechanism here cannot keep.

`phfmu.components.mechanical.multibody.mechanism_of_file` makes a `Mechanism` of what is read.  Needs the extra `mechanism`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

#: what may be left out on request
DROPPABLE = ("actuators", "armature", "contacts", "damping", "friction", "limits", "springs")


@dataclass(frozen=True)
class BodyData:
    """A body with what is welded to it, in the world: mass [kg], centre [m], tensor [kg.m2] about it, frame, velocities.

    Mass 0: a frame between the joints of one body, whose velocities follow from theirs.
    """

    name: str
    mass: float
    centre: np.ndarray
    tensor: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray


@dataclass(frozen=True)
class JointData:
    """A joint between bodies by their numbers, -1 for the ground, at a point [m] along an axis of the world.

    coordinate [rad, m]: at the start;  neutral: where its spring is at rest;  armature [kg.m2, kg];  motor: has it a port
    """

    kind: str
    name: str
    a: int
    b: int
    at: np.ndarray
    axis: np.ndarray
    damping: float = 0.0
    stiffness: float = 0.0
    coordinate: float = 0.0
    neutral: float = 0.0
    armature: float = 0.0
    motor: bool = False
    limits: LimitsData | None = None


@dataclass(frozen=True)
class LimitsData:
    """Ends of a coordinate [rad, m], that throw back with a restitution [1]."""

    lower: float
    upper: float
    restitution: float


@dataclass(frozen=True)
class GearData:
    """An equality of two joints by their numbers: rate of b = ratio times rate of a."""

    name: str
    a: int
    b: int
    ratio: float


@dataclass(frozen=True)
class MechanismData:
    """gravity [m/s2];  lost: what was left out because it was to be dropped;  assumed: what the file says otherwise."""

    name: str
    gravity: tuple[float, ...]
    bodies: tuple[BodyData, ...]
    joints: tuple[JointData, ...]
    gears: tuple[GearData, ...]
    lost: tuple[str, ...]
    assumed: tuple[str, ...]


def read_mechanism(
    path: str | Path,
    *,
    drop: Iterable[str] = (),
    qpos: Sequence[float] | None = None,
    qvel: Sequence[float] | None = None,
) -> MechanismData:
    """Read an MJCF or URDF file at its reference pose, or at MuJoCo's `qpos` with `qvel`.

    drop:    of actuators, armature, contacts, damping, friction, limits, springs: those left out, which `lost` tells
    Errors:  ValueError with one list of all that cannot be kept;  ImportError without MuJoCo
    """
    try:
        mujoco: Any = import_module("mujoco")
    except ImportError as error:
        raise ImportError('MJCF and URDF are read by MuJoCo: pip install "phfmu[mechanism]"') from error
    dropped = set(drop)
    if unknown := dropped - set(DROPPABLE):
        raise ValueError(f"drop: {', '.join(sorted(unknown))}: there are: {', '.join(DROPPABLE)}")
    try:
        model = mujoco.MjModel.from_xml_string(_text(Path(path)))
    except ValueError as error:
        raise ValueError(f"{path}: MuJoCo cannot read it: {error}") from error
    found = _found(model, mujoco)
    refused = [text for what, text in found if what not in dropped]
    if refused:
        raise ValueError(
            f"{path}: a mechanism cannot keep " + "; ".join(refused) + f"; what is optional: drop={DROPPABLE}"
        )
    data = mujoco.MjData(model)
    for array, given in ((data.qpos, qpos), (data.qvel, qvel)):
        if given is not None:
            array[:] = given
    mujoco.mj_forward(model, data)
    return _MechanismReader(model, data, mujoco, dropped).read(tuple(text for _, text in found))


def _text(path: Path) -> str:
    """MJCF as it is; of URDF without pictures and meshes, with its links kept apart."""
    text = path.read_text(encoding="utf-8")
    if "<robot" not in text:
        return text
    text = re.sub(r"<!--.*?-->|<visual.*?</visual>|<collision.*?</collision>", "", text, flags=re.DOTALL)
    compiler = '<mujoco><compiler fusestatic="false" balanceinertia="false"/></mujoco>'
    return re.sub(r"(<robot[^>]*>)", rf"\1{compiler}", text, count=1)


def _found(m: Any, mujoco: Any) -> list[tuple[str, str]]:
    """(what it is dropped by, or "", its name) of all that a mechanism cannot keep."""

    def joint_of(dof: int) -> str:
        return m.joint(int(m.dof_jntid[dof])).name or f"joint {int(m.dof_jntid[dof])}"

    def named(dofs: np.ndarray) -> str:
        return ", ".join(dict.fromkeys(joint_of(int(i)) for i in dofs))

    found = [
        ("", f"{n} {what}") for what, n in (("tendons", m.ntendon), ("flexes", m.nflex), ("plugins", m.nplugin)) if n
    ]
    rough = np.flatnonzero(m.dof_frictionloss > 0)
    if len(rough):
        found.append(("friction", f"dry friction of {named(rough)}"))
    limited = [m.joint(j).name or f"joint {j}" for j in range(m.njnt) if m.jnt_limited[j] and m.jnt_type[j] <= 1]
    if limited and not _off(m, mujoco, "LIMIT"):
        found.append(("limits", f"limits of the ball joints {', '.join(limited)}"))
    colliding = int(np.sum((m.geom_contype > 0) | (m.geom_conaffinity > 0)))
    if colliding:
        found.append(("contacts", f"contacts of {colliding} geometries"))
    sizes = [{0: 6, 1: 3}.get(int(kind), 0) for kind in m.jnt_type]
    round_joints = [int(m.jnt_dofadr[j]) + i for j, size in enumerate(sizes) for i in range(size)]
    for what, values in (("armature", m.dof_armature), ("damping", _damping(m)[:, 0])):
        bad = np.array([d for d in round_joints if values[d] > 0], int)
        if len(bad):
            found.append((what, f"{what} of the ball or free joint {named(bad)}"))
    higher = np.flatnonzero(np.any(_damping(m)[:, 1:] != 0, axis=1))
    if len(higher):
        found.append(("damping", f"damping that is not linear, of {named(higher)}"))
    for j in range(m.njnt):
        stiff = np.ravel(m.jnt_stiffness[j])
        if np.any(stiff[1:] != 0) or (stiff[0] > 0 and m.jnt_type[j] <= 1):
            found.append(("springs", f"the spring of {m.joint(j).name or f'joint {j}'}"))
    for i in range(m.nu):
        plain = m.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT and m.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_NONE
        plain = plain and m.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE
        if not plain:
            found.append(("actuators", f"the actuator {m.actuator(i).name or i}, which is no motor on a joint"))
    return found + [
        ("", f"{_equality(m, e)}, which {why}") for e in _active(m, mujoco) if (why := _no_loop(m, mujoco, e))
    ]


def _off(m: Any, mujoco: Any, flag: str) -> bool:
    """The file disables constraints, or those of a kind."""
    kinds = mujoco.mjtDisableBit
    return bool(m.opt.disableflags & (int(kinds.mjDSBL_CONSTRAINT) | int(getattr(kinds, f"mjDSBL_{flag}"))))


def _active(m: Any, mujoco: Any) -> list[int]:
    """Equalities that hold at the start."""
    return [] if _off(m, mujoco, "EQUALITY") else [e for e in range(m.neq) if m.eq_active0[e]]


def _equality(m: Any, e: int) -> str:
    return f"the equality {m.equality(e).name or e}"


def _no_loop(m: Any, mujoco: Any, e: int) -> str:
    """Why an equality is none that joints and gears can keep, or ""."""
    kinds, kind = mujoco.mjtEq, m.eq_type[e]
    if kind == kinds.mjEQ_JOINT:
        if m.eq_obj2id[e] >= 0 and np.any(m.eq_data[e][2:5]):
            return f"is a polynomial of the coordinate, {m.eq_data[e][:5].tolist()}"
        ends = [j for j in (int(m.eq_obj1id[e]), int(m.eq_obj2id[e])) if j >= 0]
        return "is of a ball or free joint" if any(m.jnt_type[j] <= 1 for j in ends) else ""
    if kind not in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
        return f"is of the kind {kinds(kind).name}"
    return "" if m.eq_objtype[e] == mujoco.mjtObj.mjOBJ_BODY else "is between sites, not bodies"


def restitution_of(solref: np.ndarray) -> float:
    """Ratio of the speeds after and before a short impact on MuJoCo's spring and damper of a limit, r'' + b r' + k r = 0.

        z = b/(2 sqrt k),   exp(-2 z/s atan2(s, z)),  s = sqrt(1 - z^2);   z > 1: exp(-2 z/s atanh(s/z)),  s = sqrt(z^2 - 1)

    It pushes and never pulls, so that it lets go where r'' = 0.

    solref:  (time constant [s], damping ratio z), or (-k, -b)
    Source:  T. Schwager, T. Poeschel, Phys. Rev. E 78 (2008), 051304;  MuJoCo's documentation of solver parameters
    """
    z = float(solref[1]) if solref[0] > 0 else float(-solref[1] / (2 * np.sqrt(-solref[0])))
    s = float(np.sqrt(abs(1 - z * z)))
    if s < 1e-8:
        return float(np.exp(-2.0))
    return float(np.exp(-2 * z / s * (np.arctan2(s, z) if z < 1 else np.arctanh(s / z))))


def _damping(m: Any) -> np.ndarray:
    """Coefficients of the damping of each degree of freedom, of rising powers of the rate (dofs x powers)."""
    values = np.asarray(m.dof_damping, float)
    return values.reshape(m.nv, -1) if m.nv else np.zeros((0, 1))


class _MechanismReader:
    """Bodies and joints of a model at a pose."""

    def __init__(self, model: Any, data: Any, mujoco: Any, dropped: set[str]):
        self.m, self.d, self.mujoco, self.dropped = model, data, mujoco, dropped
        self.roots = sorted({int(x) for x in model.body_weldid} - {0})
        self.assumed: list[str] = []
        #: the number in `joints` of each of MuJoCo's
        self.joint_number: dict[int, int] = {}
        self.number = {0: -1} | {root: i for i, root in enumerate(self.roots)}

    def read(self, lost: tuple[str, ...]) -> MechanismData:
        bodies = [self.body(root) for root in self.roots]
        joints: list[JointData] = []
        for root in self.roots:
            self.joints(root, bodies, joints)
        gears: list[GearData] = []
        self.open()
        for e in _active(self.m, self.mujoco):
            if self.m.eq_type[e] == self.mujoco.mjtEq.mjEQ_JOINT:
                self.gear(e, joints, gears)
            else:
                joints.append(self.loop(e))
        name = str(self.m.names.split(b"\0")[0].decode() or "mechanism").replace(" ", "_")
        return MechanismData(
            name, self.gravity(), tuple(bodies), tuple(joints), tuple(gears), lost, tuple(self.assumed)
        )

    def gravity(self) -> tuple[float, ...]:
        return tuple(map(float, self.m.opt.gravity))

    def body(self, root: int) -> BodyData:
        m, d = self.m, self.d
        group = [x for x in range(1, m.nbody) if m.body_weldid[x] == root]
        mass = float(sum(m.body_mass[x] for x in group))
        centre = np.average(d.xipos[group], axis=0, weights=m.body_mass[group]) if mass > 0 else d.xpos[root].copy()
        tensor = np.zeros((3, 3))
        for x in group:
            r, off = d.ximat[x].reshape(3, 3), d.xipos[x] - centre
            tensor += r @ np.diag(m.body_inertia[x]) @ r.T + m.body_mass[x] * (
                off @ off * np.eye(3) - np.outer(off, off)
            )
        rate = np.zeros(6)
        self.mujoco.mj_objectVelocity(m, d, self.mujoco.mjtObj.mjOBJ_XBODY, root, rate, 0)
        velocity = rate[3:] + np.cross(rate[:3], centre - d.xpos[root])
        rotation = d.xmat[root].reshape(3, 3).copy()
        name = m.body(root).name or f"body{root}"
        return BodyData(name, mass, centre, tensor, d.xpos[root].copy(), rotation, velocity, rate[:3].copy())

    def joints(self, root: int, bodies: list[BodyData], joints: list[JointData]) -> None:
        """The joints of a body with its parent, with massless bodies between where there are several."""
        m, d, kinds = self.m, self.d, self.mujoco.mjtJoint
        last = self.number[int(m.body_weldid[m.body_parentid[root]])]
        first, count = int(m.body_jntadr[root]), int(m.body_jntnum[root])
        for i in range(first, first + count):
            if m.jnt_type[i] == kinds.mjJNT_FREE:
                return
            end, axis, at = self.number[root], d.xaxis[i].copy(), d.xanchor[i].copy()
            if i < first + count - 1:
                end = len(bodies)
                whole, rest = bodies[self.number[root]], np.zeros(3)
                bodies.append(BodyData(f"{whole.name}_{i}", 0.0, at, np.zeros((3, 3)), at, whole.rotation, rest, rest))
            if m.jnt_type[i] == kinds.mjJNT_BALL:
                joints.append(
                    JointData("spherical", m.joint(i).name or f"joint{i}", last, end, at, np.array((0.0, 0, 1)))
                )
            else:
                self.joint_number[i] = len(joints)
                joints.append(self.single(i, last, end, at, axis))
            last = end

    def single(self, i: int, a: int, b: int, at: np.ndarray, axis: np.ndarray) -> JointData:
        """A hinge or a slider."""
        m, dof = self.m, int(self.m.jnt_dofadr[i])
        hinge = m.jnt_type[i] == self.mujoco.mjtJoint.mjJNT_HINGE
        address = int(m.jnt_qposadr[i])
        motors = [k for k in range(m.nu) if int(m.actuator_trnid[k][0]) == i]

        def kept(what: str, value: float) -> float:
            return 0.0 if what in self.dropped else float(value)

        return JointData(
            "revolute" if hinge else "prismatic", m.joint(i).name or f"joint{i}", a, b, at, axis,
            damping=kept("damping", _damping(m)[dof, 0]), armature=kept("armature", m.dof_armature[dof]),
            stiffness=kept("springs", np.ravel(m.jnt_stiffness[i])[0]),
            coordinate=float(self.d.qpos[address]), neutral=float(m.qpos_spring[address]),
            motor=bool(motors) and "actuators" not in self.dropped, limits=self.limits(i),
        )  # fmt: skip

    def limits(self, i: int) -> LimitsData | None:
        """Hard ends, where MuJoCo has a spring and a damper per unit of inertia."""
        m = self.m
        if not m.jnt_limited[i] or "limits" in self.dropped or _off(m, self.mujoco, "LIMIT"):
            return None
        (lower, upper), margin, solref = map(float, m.jnt_range[i]), float(m.jnt_margin[i]), m.jnt_solref[i]
        back = restitution_of(solref)
        text = f"time constant {solref[0]:g} s" if solref[0] > 0 else f"stiffness {-solref[0]:g} 1/s2"
        self.assumed.append(
            f"the limits of {m.joint(i).name or f'joint {i}'} are hard and throw back with a restitution of {back:.4g}, "
            f"in place of MuJoCo's {text}"
        )
        return LimitsData(lower + margin, upper - margin, back)

    def open(self) -> None:
        """ValueError for an equality that does not hold at the start."""
        m, d = self.m, self.d
        equal = d.efc_type == self.mujoco.mjtConstraint.mjCNSTR_EQUALITY
        for e in _active(m, self.mujoco):
            gap = float(np.max(np.abs(d.efc_pos[equal & (d.efc_id == e)]), initial=0.0))
            if gap > 1e-6:
                raise ValueError(
                    f"{_equality(m, e)} misses by {gap:.6g} (m or rad) at the start; give `qpos` where it holds"
                )

    def gear(self, e: int, joints: list[JointData], gears: list[GearData]) -> None:
        """An equality of the coordinates of two joints, or one that holds a joint where it is."""
        m, one, two = self.m, int(self.m.eq_obj1id[e]), int(self.m.eq_obj2id[e])
        ratio, name = float(m.eq_data[e][1]), m.equality(e).name or f"equality{e}"
        b = self.joint_number[one]
        if two >= 0 and ratio:
            gears.append(GearData(name, self.joint_number[two], b, ratio))
            return
        held = joints[b]
        joints[b] = JointData("fixed", held.name, held.a, held.b, held.at, held.axis)
        self.assumed.append(f"{held.name} is fixed by {_equality(m, e)}, and what it carries is left out")

    def loop(self, e: int) -> JointData:
        """An equality that connects or welds two bodies."""
        m, d = self.m, self.d
        one, two = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
        kind = "spherical" if m.eq_type[e] == self.mujoco.mjtEq.mjEQ_CONNECT else "fixed"
        at = d.xpos[one] + d.xmat[one].reshape(3, 3) @ m.eq_data[e][:3] if kind == "spherical" else d.xpos[two].copy()
        a, b = (self.number[int(m.body_weldid[x])] for x in (one, two))
        return JointData(kind, m.equality(e).name or f"equality{e}", a, b, at, np.array((0.0, 0, 1)))
