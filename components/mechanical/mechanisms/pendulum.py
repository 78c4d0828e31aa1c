"""A point mass on a massless bar."""

from __future__ import annotations

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Mechanism


def pendulum(*, length: float = 1.0, mass: float = 1.0) -> PHDAE:
    """A point mass on a massless bar in the plane, released horizontally, to the left of its support, at rest.

    Its period is 4 K(1/sqrt 2) sqrt(length/g) = 2.3678 s for 1 m, with the complete elliptic integral K.

    Arguments:    length [m];  mass [kg]
    Observables:  P (2) [m], the point mass, besides those of the body `bob` and the joint `bar`
    Source:       benchmark A01 of the IFToMM library of multibody problems
    """
    m = Mechanism("pendulum", planar=True, description="point mass on a bar")
    bob = m.point_mass("bob", mass, (-length, 0.0))
    m.joint("distance", "bar", None, bob, at_a=(0.0, 0.0), length=length)
    m.observe("P", bob, (0.0, 0.0), "the point mass")
    return m.build()
