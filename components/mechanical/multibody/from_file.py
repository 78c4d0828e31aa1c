"""Mechanisms from MJCF and URDF files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from phfmu.components.mechanical.multibody.assembly import project
from phfmu.components.mechanical.multibody.body import rotation_about
from phfmu.components.mechanical.multibody.mechanism import Mechanism


def mechanism_of_file(
    path: str | Path,
    *,
    drop: Iterable[str] = (),
    qpos: Sequence[float] | None = None,
    qvel: Sequence[float] | None = None,
) -> Mechanism:
    """The mechanism of an MJCF or URDF file, at its reference pose or at MuJoCo's `qpos` with `qvel`.

    Bodies with what is welded to them, hinge, slide, ball and free joints, their damping, springs and armature, equalities that
    connect or weld (exact here), motors on joints as ports named after the joint.  Parts keep their names, with `_` for
    spaces, and joints their coordinates.

    drop:    what is left out: actuators, armature, contacts, damping, friction, limits, springs
    Errors:  ValueError lists all that cannot be kept: tendons, limits, contacts, dry friction, other actuators ..
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
    for j in read.joints:
        a, b = (bodies[i] if i >= 0 else None for i in (j.a, j.b))
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
        )
        joint.start = j.coordinate
        if j.kind == "revolute":
            joint.frame_b = joint.frame_b @ rotation_about((0, 0, 1), j.coordinate)
        elif j.kind == "prismatic":
            joint.at_a = joint.at_a - j.coordinate * joint.frame_a[:, 2]
    if any(b.mass == 0 for b in m.bodies):
        project(m.bodies, m.joints, {})
    return m
