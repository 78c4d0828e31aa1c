"""The four-particle system of Kinon, Morandin and Schulze (2026), section 6.3."""

from __future__ import annotations

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Multibody


def four_particle(*, alpha: float = 0.5, eta0: float = 1.0) -> PHDAE:
    """Four particles in space, two rigid bars, two quartic springs and a state-dependent damper.

        H = 1/2 v^T M v + k13/2 (|q3 - q1|^2 - 1)^2 + k24/2 (|q4 - q2|^2 - 1)^2,
        q' = v,   M v' = -DV - R(q) v - Dg^T lambda,   0 = Dg v,   g = (|d|^2 - 1)/2 for the bars 1-2 and 3-4.

    R acts on the full relative velocity of particles 2 and 3 with eta = eta0 (1 + alpha |q3 - q2|^2).

    States:      q [m] (12), v [m/s] (12);  multipliers lambda [N/m] (2)
    Parameters:  m [kg] (4), k13, k24 [N/m3], eta0 [N.s/m], alpha [1/m2]
    Source:      Appl. Numer. Math. 2026, section 6.3 (all numbers)
    """
    body = Multibody("four_particle", description="four particles, two bars, two quartic springs, one damper (index 2)")
    k13 = body.parameter("k13", 50.0, unit="N/m3", min=0.0, description="spring between particles 1 and 3")
    k24 = body.parameter("k24", 500.0, unit="N/m3", min=0.0, description="spring between particles 2 and 4")
    eta = body.parameter("eta0", eta0, unit="N.s/m", description="damping at zero distance")
    growth = body.parameter(
        "alpha", alpha, unit="1/m2", min=0.0, description="growth of the damping with the squared distance"
    )
    p1 = body.particle(1.0, (0, 0, 0))
    p2 = body.particle(3.0, (1, 0, 0))
    p3 = body.particle(2.3, (0, 1, 0))
    p4 = body.particle(1.7, (1, 1, 0), v=(0, 0, 20.0 / 17.0))
    body.bar(p1, p2)
    body.bar(p3, p4)
    body.quartic_spring(p1, p3, k13.sx)
    body.quartic_spring(p2, p4, k24.sx)
    body.damper(p2, p3, lambda s: eta * (1.0 + growth * s))
    return body.build()
