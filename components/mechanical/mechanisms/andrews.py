"""Andrews' squeezer: seven bodies, three loops, a motor."""

from __future__ import annotations

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Mechanism

#: points on the ground [m]
A, B, C = (-0.06934, -0.00227), (-0.03635, 0.03273), (0.014, 0.072)
#: angles at the start [rad]
START = {"beta": -0.0617138900142764496, "theta": 0.0, "gamma": 0.455279819163070380, "phi": 0.222668390165885885,
         "delta": 0.487364979543842550, "omega": -0.222668390165885885, "epsilon": 1.23054744454982120}  # fmt: skip


def andrews(*, torque: float = 0.033) -> PHDAE:
    """Andrews' squeezing mechanism in the plane without gravity: a motor with a constant torque drives seven bodies.

    beta, theta:     crank from the x axis, and rod beside the crank
    gamma:           rocker at B with the spring to C
    phi, delta:      link beside its arm, and arm at A
    omega, epsilon:  link beside its arm, and arm at A

    Arguments:    torque [N.m] at the port `motor` at the start
    Port:         motor: torque given, speed out
    Observables:  the seven angles [rad], of which beta and theta count turns, besides those of bodies and joints
    Source:       W. Schiehlen (ed.), Multibody Systems Handbook, Springer 1990; E. Hairer, G. Wanner, Solving Ordinary
                  Differential Equations II, section VII.7; benchmark A03 of the IFToMM library of multibody problems
    """
    m = Mechanism("andrews", planar=True, gravity=(0.0, 0.0), description="Andrews' squeezer")
    # frames at the joint of each body with the one before it
    crank = m.body("crank", 0.04325, 2.194e-6, com=(0.00092, 0.0))
    rod = m.body("rod", 0.00365, 4.410e-7, com=(-0.0115, 0.0))
    rocker = m.body("rocker", 0.02373, 5.255e-6, com=(0.01043, -0.01874))
    link4 = m.body("link4", 0.00706, 5.667e-7, com=(0.0, -0.00579))
    arm5 = m.body("arm5", 0.07050, 1.169e-5, com=(0.02308, 0.00916))
    link6 = m.body("link6", 0.00706, 5.667e-7, com=(0.00579, 0.0))
    arm7 = m.body("arm7", 0.05498, 1.912e-5, com=(0.00449, -0.01228))
    angles = {
        "beta": m.joint("revolute", "motor", None, crank, motor=True, turns=True),
        "theta": m.joint("revolute", "K2", crank, rod, at_a=(0.007, 0.0), turns=True),
        "gamma": m.joint("revolute", "B", None, rocker, at_a=B),
        "delta": m.joint("revolute", "A5", None, arm5, at_a=A),
        "phi": m.joint("revolute", "K4", arm5, link4, at_a=(0.04, 0.0)),
        "epsilon": m.joint("revolute", "A7", None, arm7, at_a=A),
        "omega": m.joint("revolute", "K6", arm7, link6, at_a=(0.0, -0.04)),
    }
    for name, body, end in (("F3", rocker, (0.0, -0.035)), ("F4", link4, (0.0, -0.02)), ("F6", link6, (0.02, 0.0))):
        m.joint("revolute", name, rod, body, at_a=(-0.028, 0.0), at_b=end)
    m.spring("spring", (rocker, (0.02, -0.018)), (None, C), 4530.0, 0.07785)
    m.assemble({joint.name: START[name] for name, joint in angles.items()})
    for name, joint in angles.items():
        m.observe(name, joint)
    return m.build().with_starts({"motor.torque": torque})
