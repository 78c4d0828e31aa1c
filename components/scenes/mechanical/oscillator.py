"""Two masses and three springs, cut in three members."""

from __future__ import annotations

from math import pi

from phfmu import Network, Scene
from phfmu.components.mechanical.translational import mass, spring


def oscillator() -> Scene:
    """m1 = m2 = 1 kg, k1 = k2 = 4 pi^2 N/m to ground, k12 = 16 pi^2 N/m between; released from q = (1, 0).

    Exact: q1 = (cos 2 pi t + cos 6 pi t)/2, q2 = (cos 2 pi t - cos 6 pi t)/2.
    Source: the oscillator benchmark of the preCICE tutorials (parameters).
    """
    net = Network("oscillator", description="two masses and three springs, cut in three")
    net.add("mass1", mass(1.0, k=4 * pi**2, q=1.0))
    net.add("mass2", mass(1.0, k=4 * pi**2))
    net.add("spring12", spring(16 * pi**2, elongation=-1.0))
    net.connect("mass1.flange", "spring12.a", name="left")
    net.connect("mass2.flange", "spring12.b", name="right")
    return Scene("oscillator", net, stop=1.0, step=0.01, shown=("mass1.q", "mass2.q", "mass1.v", "mass2.v"))
