"""A robot arm of seven joints: the Panda of Franka Emika, from the numbers of its URDF."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from phfmu import PHDAE, Scene
from phfmu.components.mechanical.mechanisms.ur5 import carrying
from phfmu.components.mechanical.multibody import Mechanism
from phfmu.components.mechanical.multibody.body import rotation_about
from phfmu.components.mechanical.multibody.joint import finite
from phfmu.components.scenes.mechanical.robot_arm import pushed

#: mass [kg], centre of mass [m], xx, xy, xz, yy, yz, zz [kg.m2] of links 1 to 7 and of the hand, which is fixed to the last link
LINKS = (
    (4.970684, (0.003875, 0.002081, -0.04762), (0.70337, -0.000139, 0.006772, 0.70661, 0.019169, 0.009117)),
    (0.646926, (-0.003141, -0.02872, 0.003495), (0.007962, -0.003925, 0.010254, 0.02811, 0.000704, 0.025995)),
    (3.228604, (0.027518, 0.039252, -0.066502), (0.037242, -0.004761, -0.011396, 0.036155, -0.012805, 0.01083)),
    (3.587895, (-0.05317, 0.104419, 0.027454), (0.025853, 0.007796, -0.001332, 0.019552, 0.008641, 0.028323)),
    (1.225946, (-0.011953, 0.041065, -0.038437), (0.035549, -0.002117, -0.004037, 0.029474, 0.000229, 0.008627)),
    (1.666555, (0.060149, -0.014117, -0.010517), (0.001964, 0.000109, -0.001158, 0.004354, 0.000341, 0.005433)),
    (0.735522, (0.010517, -0.004252, 0.061597), (0.012516, -0.000428, -0.001196, 0.010027, -0.000741, 0.004815)),
    (0.73, (-0.01, 0.0, 0.03), (0.001, 0.0, 0.0, 0.0025, 0.0, 0.0017)),
)
#: place [m] and turn about x and z [rad] of each link in the frame of the one before; joints turn about z
FRAMES = (
    ((0.0, 0.0, 0.333), 0.0, 0.0), ((0.0, 0.0, 0.0), -pi / 2, 0.0), ((0.0, -0.316, 0.0), pi / 2, 0.0),
    ((0.0825, 0.0, 0.0), pi / 2, 0.0), ((-0.0825, 0.384, 0.0), -pi / 2, 0.0), ((0.0, 0.0, 0.0), pi / 2, 0.0),
    ((0.088, 0.0, 0.0), pi / 2, 0.0), ((0.0, 0.0, 0.107), 0.0, -pi / 4),
)  # fmt: skip
#: what the hand holds in the frame of the last link [m]
TOOL = (0.0, 0.0, 0.2104)
#: angles [rad] in which the arm waits
READY = (0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4)
#: torques beside those that carry the arm at its start [N.m]
PUSHES = {"joint1": 12.0, "joint3": -6.0, "joint4": 8.0, "joint6": -1.0}
#: friction of the joints [N.m.s/rad]; those of the wrist move little mass
FRICTION = (5.0, 5.0, 5.0, 5.0, 0.5, 0.5, 0.5)


def panda_arm(pose: Sequence[float] = READY, *, damping: Sequence[float] = (0.0,) * 7, carried: bool = False) -> PHDAE:
    """Seven links in a row on a fixed base, each with a motor in its joint, and a hand on the last of them.

        M(q) q'' + c(q, q') + g(q) + damping q' = tau       in the angles q of the joints, 0 of the arm stretched upwards

    stepped in centres of mass and directors of the links (see `Mechanism`), where the mass matrix is constant and diagonal.

    Arguments:    pose [rad]: of the seven joints along the arm, at the start;  damping [N.m.s/rad] of each
                  carried: the torques begin as those that carry the resting arm in its pose; else with 0, and the arm falls
    Ports:        joint1, .. joint7 (torque given, speed out)
    Observables:  tool [m], and those of the bodies link1, .. link7 and of the joints
    Errors:       ValueError for a pose or damping that is not seven finite numbers
    The second link has a direction nearly without mass, by its published moments.  Left out are fingers, rotors of motors, and
    limits of angles, speeds and torques (87 N.m, in the last three joints 12 N.m).
    Source:       panda.urdf of franka_description (Apache licence), as in the package example-robot-data 6.0.0
    """
    angles, friction = finite("panda: pose", pose, 7), finite("panda: damping", damping, 7)
    m = Mechanism("panda", description="robot arm Panda: seven links, seven motors")
    place, turn, before = np.zeros(3), np.eye(3), None
    for i, (at, about_x, _) in enumerate(FRAMES[:7]):
        place, turn = place + turn @ at, turn @ rotation_about((1, 0, 0), about_x)
        mass, com, tensor = _with_hand() if i == 6 else (LINKS[i][0], LINKS[i][1], _tensor(LINKS[i][2]))
        body = m.body(f"link{i + 1}", mass, tensor, com=com, position=place.tolist(), rotation=turn)
        axis, braked = turn[:, 2].tolist(), float(friction[i])
        m.joint("revolute", f"joint{i + 1}", before, body, at=place.tolist(), axis=axis, damping=braked, motor=True)
        before = body
    m.assemble({j.name: angle for j, angle in zip(m.joints, angles, strict=True)})
    m.observe("tool", m.bodies[-1], TOOL, "middle of what the hand holds")
    made = m.build()
    return made.with_starts(carrying(m)) if carried else made


def _tensor(moments: Sequence[float]) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = moments
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _with_hand() -> tuple[float, list[float], np.ndarray]:
    """Mass, centre of mass and tensor about it of the last link and the hand together, in the frame of the link."""
    (m1, c1, j1), (m2, c2, j2), (at, _, about_z) = *LINKS[6:], FRAMES[7]
    turn = rotation_about((0, 0, 1), about_z)
    first, second = np.array(c1), at + turn @ c2
    apart, mass = second - first, m1 + m2
    pair = m1 * m2 / mass * (apart @ apart * np.eye(3) - np.outer(apart, apart))
    return mass, ((m1 * first + m2 * second) / mass).tolist(), _tensor(j1) + turn @ _tensor(j2) @ turn.T + pair


def panda(*, t_go: float = 0.1, t_back: float = 0.35, t_rest: float = 0.6, stop: float = 1.0) -> Scene:
    """A Panda whose motors first carry it in its pose, then push four of its seven joints, then brake them.

    Arguments: t_go [s], when PUSHES are added to the torques;  t_back [s], when they are turned round;  t_rest [s], when they
               end;  stop [s]

    As in `robot_arm` torques are given and not controlled.  Seven joints move a tool that has six degrees of freedom; the ledger
    has the work of each motor and what the friction of the joints takes.
    """
    arm = panda_arm(damping=FRICTION, carried=True)
    return Scene(
        "panda",
        arm,
        stop=stop,
        step=2e-3,
        events=pushed(arm, PUSHES, (t_go, t_back, t_rest)),
        description="robot arm of seven joints, carried, moved and stopped",
        shown=("joint1.angle", "joint3.angle", "joint4.angle", "joint6.angle", "tool", "joint4.torque"),
    )
