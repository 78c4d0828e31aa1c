"""A rope bridge: planks between two ropes."""

from __future__ import annotations

import numpy as np

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Mechanism


def rope_bridge(
    n: int = 10, *, span: float = 10.0, width: float = 1.0, sag: float = 0.5, plank: float = 8.0, gust: float = 0.5
) -> PHDAE:
    """n planks, thin rods across, whose ends hang on two ropes of n + 1 rigid segments between four fixed points.

    At the start the ropes are polygons whose slopes fall from one end to the other by equal steps, and a gust has set the planks
    in motion sideways.  Each segment is a constraint, so that 2 (n + 1) of them are in a row of n bodies.

    Arguments:    n;  span [m] between the banks, width [m] of the planks;  sag [rad]: slope of the ropes at the banks
                  plank [kg]: mass of one;  gust [m/s]: speed across of the middle of the bridge
    Observables:  plank1, ..: position, direction, momentum, energy;  left1.force, .. and right1.force, ..: of the segments
    """
    if n < 1:
        raise ValueError(f"rope_bridge: {n} planks; at least one")
    m = Mechanism("rope_bridge", description=f"bridge of {n} planks between two ropes")
    slopes = np.linspace(-sag, sag, n + 1)
    length = span / float(np.cos(slopes).sum())
    x, z = (np.concatenate([[0.0], np.cumsum(length * f(slopes))]) for f in (np.cos, np.sin))
    across = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).T  # x of a rod along y
    planks = [
        m.rod(f"plank{i}", plank, width, position=(x[i], 0.0, z[i]), rotation=across, velocity=(0.0, gust * s, 0.0))
        for i, s in enumerate(np.sin(np.pi * x / span))
        if 0 < i <= n
    ]
    for side, half in (("left", 0.5 * width), ("right", -0.5 * width)):
        chain = [None, *planks, None]
        for i, (a, b) in enumerate(zip(chain[:-1], chain[1:], strict=True)):
            ends = [(x[k], half, z[k]) if body is None else (half, 0.0, 0.0) for k, body in ((i, a), (i + 1, b))]
            m.joint("distance", f"{side}{i + 1}", a, b, at_a=ends[0], at_b=ends[1], length=length)
    return m.build()
