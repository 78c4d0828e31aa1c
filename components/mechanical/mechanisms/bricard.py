"""Bricard's linkage: six hinges with one equation more than independent ones."""

from __future__ import annotations

import numpy as np

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Mechanism

#: hinges along an edge walk of the unit cube, and their axes
CORNERS = ((0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1))
AXES = ((0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0))


def bricard(*, length: float = 1.0, mass: float = 1.0, section: float = 0.0) -> PHDAE:
    """Five rods along edges of a cube, joined to each other and to the ground by six hinges; gravity along -y; from rest.

    By the count of equations it could not move; because of the directions of its axes it has one degree of freedom.

    Arguments:    length [m] and mass [kg] of a rod;  section [m]: side of its square section, 0: thin rods, whose inertia
                  about their axes is zero
    Observables:  P1 .. P4 (3) [m], the hinges that move, besides those of bodies and joints
    Source:       R. Bricard (1897); benchmark A04 of the IFToMM library of multibody problems
    """
    m = Mechanism("bricard", gravity=(0.0, -9.81, 0.0), description="Bricard's linkage")
    points = length * np.array(CORNERS, float)
    along, across = mass * length**2 / 12, mass * section**2 / 12
    last = None
    for i, (start, end) in enumerate(zip(points, points[1:], strict=False)):
        x = (end - start) / length
        y = np.roll(x, 1)
        rotation = np.column_stack((x, y, np.cross(x, y)))
        inertia = (2 * across, along + across, along + across)
        rod = m.body(f"rod{i + 1}", mass, inertia, position=((start + end) / 2).tolist(), rotation=rotation)
        m.joint("revolute", f"hinge{i}", last, rod, at=start.tolist(), axis=AXES[i])
        if i < 4:
            m.observe(f"P{i + 1}", rod, (length / 2, 0.0, 0.0), f"hinge {i + 1}")
        last = rod
    m.joint("revolute", "hinge5", last, None, at=points[5].tolist(), axis=AXES[5])
    return m.build()
