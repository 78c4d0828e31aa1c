"""Rows of four-bar windows through positions in which their constraints lose rank."""

from __future__ import annotations

from typing import Any

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Mechanism


def four_bar(n: int = 2, *, length: float = 1.0, mass: float = 1.0, speed: float = 1.0) -> PHDAE:
    """n four-bar windows: n + 1 parallel cranks on the ground, joined by n couplers, all uniform rods, in the plane.

    All cranks stand upright at the start, and the point B0, the upper end of the first, moves to the right.  Twice per turn all
    rods lie in one line: there the mechanism has n + 1 degrees of freedom for an instant.  The cranks keep parallel, so that
    their angle from the vertical is that of a pendulum: J a'' = g S sin a with J = m l^2 ((n+1)/3 + n), S = m l ((n+1)/2 + n).

    Arguments:    n windows;  length [m] and mass [kg] of a rod;  speed [m/s] of B0 at the start
    Observables:  B0 (2) [m], besides those of bodies `crank0`.. and `coupler1`.. and joints
    Source:       benchmark A02 of the IFToMM library of multibody problems
    """
    if n < 1:
        raise ValueError(f"four_bar: n = {n} windows; it needs at least one")
    m = Mechanism("four_bar", planar=True, description=f"{n} four-bar windows")
    spin, half = -speed / length, length / 2
    cranks: list[Any] = []
    for i in range(n + 1):
        place = {"position": (i * length, half), "velocity": (speed / 2, 0.0)}
        cranks.append(m.rod(f"crank{i}", mass, length, rotation=1.5707963267948966, angular_velocity=spin, **place))
        m.joint("revolute", f"A{i}", None, cranks[i], at=(i * length, 0.0))
    for i in range(1, n + 1):
        coupler = m.rod(f"coupler{i}", mass, length, position=((i - 0.5) * length, length), velocity=(speed, 0.0))
        m.joint("revolute", f"left{i}", cranks[i - 1], coupler, at=((i - 1) * length, length))
        m.joint("revolute", f"right{i}", cranks[i], coupler, at=(i * length, length))
    m.observe("B0", cranks[0], (half, 0.0), "upper end of the first crank")
    return m.build()
