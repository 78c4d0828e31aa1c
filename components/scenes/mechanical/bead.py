"""A bead that slides off a cylinder."""

from __future__ import annotations

import casadi as ca

from phfmu import PHDAE, Scene, Switch, algebraic, energy, observable, parameter, skew, state


def bead(speed: float = 0.5, *, r: float = 1.0, m: float = 0.2, g: float = 9.81) -> Scene:
    """A bead on top of a smooth cylinder, pushed with `speed`; it leaves where the force of the cylinder falls to zero.

        H = |p|^2/(2 m) + m g y,   q' = p/m,   p' = -m g e_y + N n,   n = q/|q|;   0 <= N,  0 <= |q| - r,  complementary

    It leaves at the height r (2/3 + speed^2/(3 g r)) and falls in a parabola.  The radius is kept exactly while it slides.

    Arguments:  speed [m/s] at the start, radius r [m]
    States:     q (2) [m], from the axis; p (2) [kg.m/s];  algebraic: N [N]
    Parameters: m [kg], g [m/s2], slides (mode: 1 on the cylinder, 0 in the air)
    """
    q = state("q", 2, unit="m", start=(0.0, r), nominal=r, description="position from the axis")
    p = state("p", 2, unit="kg.m/s", start=(m * speed, 0.0), nominal=m * (g * r) ** 0.5, description="momentum")
    force = algebraic("N", unit="N", nominal=m * g, description="force of the cylinder")
    ms, gs = parameter("m", m, unit="kg", positive=True), parameter("g", g, unit="m/s2", positive=True)
    radius = parameter("r", r, unit="m", positive=True, description="of the cylinder")
    slides = parameter("slides", 1.0, min=0.0, max=1.0, description="1 on the cylinder, 0 in the air")
    normal = q.sx / ca.norm_2(q.sx)
    contact = Switch(
        "contact", force, {p: normal}, slides, gap=ca.norm_2(q.sx) - radius.sx, nominal=r, unit="m"
    )  # fmt: skip
    model = PHDAE(
        "bead",
        states=(q, p),
        algebraics=(force,),
        parameters=(ms, gs, radius, slides),
        energies=(energy(ca.sumsqr(p.sx) / (2 * ms)), energy(ms * gs * q[1])),
        structure=(skew(q, p, 1.0),),
        switches=(contact,),
        observables=(observable("radius", ca.norm_2(q.sx), unit="m", description="distance from the axis"),),
        description="bead that slides off a cylinder",
    )
    return Scene("bead", model, stop=0.8, step=0.01, shown=("q", "N"))
