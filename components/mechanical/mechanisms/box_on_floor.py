"""A box that is thrown onto the floor."""

from __future__ import annotations

import numpy as np

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Compliance, Mechanism
from phfmu.components.mechanical.multibody.body import rotation_about


def box_on_floor(
    *,
    size: tuple[float, float, float] = (0.4, 0.3, 0.2),
    mass: float = 1.0,
    height: float = 0.6,
    spin: tuple[float, float, float] = (1.0, 2.0, 0.5),
    restitution: float = 0.6,
    skin: float = 0.01,
) -> PHDAE:
    """A uniform box falls turned onto a floor without friction, is thrown back by its corners, and comes to rest.

    The floor is hard and throws back with a restitution; the box has a skin of rubber, of which a corner gives way by a quarter
    under a quarter of the weight, so that it can lie.  Without skin it must not: the impacts would follow each other for ever.

    Arguments:    size [m]: edges;  mass [kg];  height [m] of the centre at the start;  spin [rad/s];  restitution [1];
                  skin [m], 0 for none
    Events:       corner1 to corner8, with what they lose
    Observables:  of the body box;  corner1.gap to corner8.gap [m]
    """
    m = Mechanism("box_on_floor", description="box thrown onto a hard floor")
    edges = np.array(size)
    moments = mass / 12.0 * (edges @ edges - edges**2)
    turned = rotation_about((1.0, 0.3, 0.2), 0.5)
    box = m.body("box", mass, moments, position=(0.0, 0.0, height), rotation=turned, angular_velocity=spin)
    weight = mass * float(np.linalg.norm(m.parts.gravity))
    rubber = Compliance(weight / skin, damping=2.0, skin=skin) if skin else None
    m.box_contact("corner", None, box, size, restitution=restitution, compliance=rubber)
    return m.build()
