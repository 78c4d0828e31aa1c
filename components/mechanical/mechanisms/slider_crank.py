"""A slider-crank with a torque motor."""

from __future__ import annotations

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Mechanism


def slider_crank(
    *,
    crank: float = 0.3,
    rod: float = 0.8,
    masses: tuple[float, float, float] = (1.0, 0.5, 0.8),
    friction: float = 0.01,
    angle: float = 0.5,
    speed: float = 10.0,
) -> PHDAE:
    """Crank and rod, both uniform, and a piston that slides along x, in the plane.

    Arguments:    lengths of crank and rod [m];  masses [kg] of crank, rod, piston;  friction [N.m.s/rad] of the main bearing;
                  angle [rad] and speed [rad/s] of the crank at the start
    Ports:        main (torque on the crank given, speed out);  bore (force on the piston given, velocity out)
    Observables:  those of the bodies crank, rod, piston and the joints main, big_end, small_end, bore
    """
    m = Mechanism("slider_crank", planar=True, description="crank, rod and piston")
    first, second = m.rod("crank", masses[0], crank), m.rod("rod", masses[1], rod)
    piston = m.body("piston", masses[2], masses[2] * (0.1 * crank) ** 2)
    m.joint("revolute", "main", None, first, at_b=(-crank / 2, 0.0), motor=True, damping=friction)
    m.joint("revolute", "big_end", first, second, at_a=(crank / 2, 0.0), at_b=(-rod / 2, 0.0))
    m.joint("revolute", "small_end", second, piston, at_a=(rod / 2, 0.0))
    m.joint("prismatic", "bore", None, piston, axis=(1.0, 0.0), motor=True)
    m.assemble({"main": angle}, speeds={"main": speed})
    return m.build()
