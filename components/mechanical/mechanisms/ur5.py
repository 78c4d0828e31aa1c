"""The robot arm UR5 of Universal Robots, from the numbers of its URDF."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Mechanism
from phfmu.components.mechanical.multibody.body import rotation_about
from phfmu.components.mechanical.multibody.joint import finite

#: links: name, mass [kg], centre of mass along z of the frame [m], moments about x, y, z there [kg.m2]
LINKS = (
    ("shoulder_link", 3.7, 0.0, (0.010267495893, 0.010267495893, 0.00666)),
    ("upper_arm_link", 8.393, 0.28, (0.22689067591, 0.22689067591, 0.0151074)),
    ("forearm_link", 2.275, 0.25, (0.049443313556, 0.049443313556, 0.004095)),
    ("wrist_1_link", 1.219, 0.0, (0.111172755531, 0.111172755531, 0.21942)),
    ("wrist_2_link", 1.219, 0.0, (0.111172755531, 0.111172755531, 0.21942)),
    ("wrist_3_link", 0.1879, 0.0, (0.0171364731454, 0.0171364731454, 0.033822)),
)
#: the joint before each link: name, place in the frame of the link before [m], turn of the link's frame about y [rad], axis
JOINTS = (
    ("shoulder_pan", (0.0, 0.0, 0.089159), 0.0, (0.0, 0.0, 1.0)),
    ("shoulder_lift", (0.0, 0.13585, 0.0), pi / 2, (0.0, 1.0, 0.0)),
    ("elbow", (0.0, -0.1197, 0.425), 0.0, (0.0, 1.0, 0.0)),
    ("wrist_1", (0.0, 0.0, 0.39225), pi / 2, (0.0, 1.0, 0.0)),
    ("wrist_2", (0.0, 0.093, 0.0), 0.0, (0.0, 0.0, 1.0)),
    ("wrist_3", (0.0, 0.0, 0.09465), 0.0, (0.0, 1.0, 0.0)),
)
#: the flange in the frame of the last link [m]
FLANGE = (0.0, 0.0823, 0.0)


def ur5(
    pose: Sequence[float] = (0.3, -1.2, 1.0, -0.8, -1.2, 0.4),
    *,
    speeds: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    damping: float = 0.0,
    carried: bool = False,
) -> PHDAE:
    """Six links in a row on a fixed base, each with a motor in its joint.

        M(q) q'' + c(q, q') + g(q) + damping q' = tau       in the angles q of the joints, 0 of the arm stretched along x

    stepped in centres of mass and directors of the links (see `Mechanism`), where the mass matrix is constant and diagonal.

    Arguments:    pose [rad], speeds [rad/s]: of the six joints along the arm, at the start;  damping [N.m.s/rad] of each joint
                  carried: the torques begin as those that carry the resting arm in its pose; else with 0, and the arm falls
    Ports:        shoulder_pan, shoulder_lift, elbow, wrist_1, wrist_2, wrist_3 (torque given, speed out)
    Observables:  flange [m], and those of the bodies shoulder_link, .. wrist_3_link and of the joints
    Errors:       ValueError for a pose or speeds that are not six finite numbers
    The links are as the file has them, in which those of the wrist have the moments of larger bodies.  Left out are rotors of
    the motors, friction, and limits: of angles, of speeds (3.15 rad/s), of torques (150 N.m, in the wrist 28 N.m).
    Source:       ur5_robot.urdf of ur_description (ROS-Industrial, universal_robot, branch kinetic-devel; BSD licence), as in the
                  package example-robot-data 6.0.0
    """
    q, w = finite("ur5: pose", pose, 6), finite("ur5: speeds", speeds, 6)
    m = Mechanism("ur5", description="robot arm UR5: six links, six motors")
    place, turn, before = np.zeros(3), np.eye(3), None
    for (link, mass, z, moments), (joint, at, pitch, axis) in zip(LINKS, JOINTS, strict=True):
        place, turn = place + turn @ at, turn @ rotation_about((0, 1, 0), pitch)
        body = m.body(link, mass, moments, com=(0.0, 0.0, z), position=place.tolist(), rotation=turn)
        m.joint(
            "revolute", joint, before, body, at=place.tolist(), axis=(turn @ axis).tolist(), damping=damping, motor=True
        )
        before = body
    names = [name for name, *_ in JOINTS]
    m.assemble(dict(zip(names, q, strict=True)), speeds=dict(zip(names, w, strict=True)))
    m.observe("flange", m.bodies[-1], FLANGE, "middle of the flange")
    made = m.build()
    return made.with_starts(carrying(m)) if carried else made


def carrying(m: Mechanism) -> dict[str, float]:
    """The torques that hold an arm, whose joint i is before its body i: tau_i = -z_i . sum_j (c_j - p_i) x m_j g, j from i."""
    out = {}
    for i, joint in enumerate(m.joints):
        _, _, at, axes = joint.sides()
        moment = sum(np.cross(b.centre - at, b.mass * m.parts.gravity) for b in m.bodies[i:])
        out[f"{joint.name}.torque"] = -float(axes[:, 2] @ moment)
    return out
