"""Mechanisms from MJCF and URDF files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from phfmu.components.mechanical.multibody.assembly import project
from phfmu.components.mechanical.multibody.body import rotation_about
from phfmu.components.mechanical.multibody.contact import Compliance, Limits
from phfmu.components.mechanical.multibody.joint import KinematicJoint
from phfmu.components.mechanical.multibody.mechanism import Mechanism


def mechanism_of_file(
    path: str | Path,
    *,
    drop: Iterable[str] = (),
    qpos: Sequence[float] | None = None,
    qvel: Sequence[float] | None = None,
    compliance: Compliance | None = None,
) -> Mechanism:
    """The mechanism of an MJCF or URDF file, at its reference pose or at MuJoCo's `qpos` with `qvel`.

    Bodies with what is welded to them, hinge, slide, ball and free joints, their damping, springs and armature, equalities that
    connect or weld (exact here), limits, equalities of two joints as gears, motors on joints as ports named after the joint.
    Parts keep their names, with `_` for spaces, and joints their coordinates; `Mechanism.assumed` has what was read otherwise.

    Limits of hinges and sliders are hard, as files of robots mean them: MuJoCo's ends give way by a stiffness and a damping per
    unit of inertia, an impact on which has, as it gets short, the restitution that theirs have here.

    drop:    what is left out: actuators, armature, contacts, damping, friction, limits, springs
    compliance: ends of joints that give way, and may hold, in place of hard ones
    Errors:  ValueError lists all that cannot be kept: tendons, contacts, dry friction, other actuators ..; or names an equality
             that does not hold at the start
    Needs:   the extra `mechanism` (MuJoCo)
    """
    from phfmu.importers.mechanism import read_mechanism

    read = read_mechanism(path, drop=drop, qpos=qpos, qvel=qvel)
    m = Mechanism(read.name, gravity=read.gravity, description=f"mechanism of {Path(path).name}")
    bodies = [
        m.body(
            b.name.replace(" ", "_"),
            b.mass,
            b.rotation.T @ b.tensor @ b.rotation,
            com=(b.rotation.T @ (b.centre - b.position)).tolist(),
            position=b.position.tolist(),
            rotation=b.rotation,
            velocity=b.velocity.tolist(),
            angular_velocity=b.angular_velocity.tolist(),
        )
        for b in read.bodies
    ]
    joints: list[KinematicJoint] = []
    for j in read.joints:
        a, b = (bodies[i] if i >= 0 else None for i in (j.a, j.b))
        ends = j.limits
        joint = m.joint(
            j.kind,
            j.name.replace(" ", "_"),
            a,
            b,
            at=j.at.tolist(),
            axis=j.axis.tolist(),
            damping=j.damping,
            stiffness=j.stiffness,
            neutral=j.neutral,
            armature=j.armature,
            motor="effort" if j.motor else "",
            limits=None if ends is None else Limits(ends.lower, ends.upper, ends.restitution, compliance),
        )
        joints.append(joint)
        joint.start = j.coordinate
        if j.kind == "revolute":
            joint.frame_b = joint.frame_b @ rotation_about((0, 0, 1), j.coordinate)
        elif j.kind == "prismatic":
            joint.at_a = joint.at_a - j.coordinate * joint.frame_a[:, 2]
    for g in read.gears:
        m.gear(g.name.replace(" ", "_"), joints[g.a], joints[g.b], g.ratio)
    m.assumed = read.assumed
    if any(b.mass == 0 for b in m.bodies):
        project(m.bodies, m.joints, {})
    return m
