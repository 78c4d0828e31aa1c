"""The stiff flyball governor: arms on a turning shaft, held to a slider by springs and dampers."""

from __future__ import annotations

from math import pi

import numpy as np

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Mechanism
from phfmu.components.mechanical.multibody.body import rotation_about

DENSITY = 3000.0


def flyball(*, stiffness: float = 8e5, damping: float = 4e4, ball: float = 5.0, speed: float = 2 * pi) -> PHDAE:
    """A vertical shaft turns freely; two arms with balls hang on it, stiff springs and dampers join their middles to a slider.

    The shaft stands on z = 0 and is 1 m long, arms of 1 m are hinged 0.05 m beside its top, at first 30 degrees below the
    horizontal; shaft and arms have a section of 0.01 m, the slider is a cube of 0.1 m, all of 3000 kg/m3.

    Arguments:    stiffness [N/m] and damping [N.s/m] of the springs, of 0.5 m;  ball [kg];  speed [rad/s] of the shaft
    Observables:  s [m], the height of the slider on the shaft, besides those of bodies and joints
    Source:       benchmark A05 of the IFToMM library of multibody problems
    """
    m = Mechanism("flyball", description="stiff flyball governor")
    bar, cube = DENSITY * 1e-4, DENSITY * 1e-3
    thin, long = bar * 2e-4 / 12, bar * (1.0 + 1e-4) / 12
    shaft = m.body("shaft", bar, (long, long, thin), position=(0.0, 0.0, 0.5))
    slider = m.body("slider", cube, 3 * (cube * 0.01 / 6,), position=(0.0, 0.0, 0.5))
    m.joint("revolute", "bearing", None, shaft, at=(0.0, 0.0, 0.0))
    guide = m.joint("prismatic", "guide", shaft, slider, at_a=(0.0, 0.0, -0.5), at_b=(0.0, 0.0, 0.0))
    for name, side in (("left", -1.0), ("right", 1.0)):
        # an arm with its ball: frame at the hinge, z along it
        mass, com = bar + ball, (0.5 * bar + ball) / (bar + ball)
        about = np.array((long, long, thin)) + (bar * 0.25 + ball) * np.array((1.0, 1.0, 0.0))
        direction = rotation_about((0, 1, 0), side * 2 * pi / 3)
        arm = m.body(
            name, mass, about, com=(0.0, 0.0, com), about=(0.0, 0.0, 0.0), position=(side * 0.05, 0.0, 1.0), rotation=direction
        )  # fmt: skip
        m.joint("revolute", f"{name}_hinge", shaft, arm, at=(side * 0.05, 0.0, 1.0), axis=(0.0, 1.0, 0.0))
        m.spring(f"{name}_spring", (slider, (side * 0.05, 0.0, 0.0)), (arm, (0.0, 0.0, 0.5)), stiffness, 0.5, damping)
    m.assemble(speeds={"bearing": speed})
    m.observe("s", guide, description="height of the slider")
    return m.build()
