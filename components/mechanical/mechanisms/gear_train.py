"""A motor that lifts a load by wheels in mesh and a rack."""

from __future__ import annotations

from math import cos, sin

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Mechanism


def gear_train(
    *,
    radii: tuple[float, ...] = (0.02, 0.06, 0.03),
    inertias: tuple[float, ...] = (2e-5, 1e-3, 2e-4),
    load: float = 2.0,
    friction: float = 1e-4,
    slope: float = 0.3,
    torque: float = 0.2,
) -> PHDAE:
    """Wheels in mesh along a line, of which the last one drives a rack up a slope.

        (sum J_i (r_1/r_i)^2 + load r_1^2) w' = torque - friction w - load g r_1 sin(slope),   w: speed of the first wheel

    Arguments:    radii [m] and inertias [kg.m2] of the wheels;  load [kg]: mass of the rack and of what it carries
                  friction [N.m.s/rad] of the first wheel;  slope [rad];  torque [N.m] of the motor at the start
    Ports:        motor (torque on the first wheel given, speed out);  lift (force on the rack given, velocity out)
    Observables:  mesh1.torque, ..: torque on the driven wheel;  slide.force on the rack;  those of bodies and joints
    """
    if len(radii) != len(inertias) or len(radii) < 2:
        raise ValueError(f"gear_train: {len(radii)} radii and {len(inertias)} inertias; give as many, two at least")
    m = Mechanism("gear_train", planar=True, description="wheels in mesh that lift a load by a rack")
    at, joints = 0.0, []
    for i, (r, inertia) in enumerate(zip(radii, inertias, strict=True)):
        at += 0.0 if i == 0 else radii[i - 1] + r
        wheel = m.body(f"wheel{i + 1}", 0.5, inertia, position=(at, 0.0))
        name = "motor" if i == 0 else f"shaft{i + 1}"
        joints.append(
            m.joint("revolute", name, None, wheel, at=(at, 0.0), motor=i == 0, damping=0.0 if i else friction)
        )
    rack = m.body("rack", load, load * 1e-4, position=(at, -radii[-1]), rotation=slope)
    along = (cos(slope), sin(slope))
    lift = m.joint("prismatic", "lift", None, rack, at=(at, -radii[-1]), axis=along, motor=True)
    for i, (a, b) in enumerate(zip(joints[:-1], joints[1:], strict=True)):
        m.gear(f"mesh{i + 1}", a, b, -radii[i] / radii[i + 1])
    m.gear("slide", joints[-1], lift, radii[-1])
    m.assemble()
    return m.build().with_starts({"motor.torque": torque})
