"""Inertias and shafts."""

from __future__ import annotations

from phfmu import PHDAE, ROTATIONAL, Port, algebraic, damping, energy, parameter, skew, state


def rotational_inertia(J: float = 1.0, *, d: float = 0.0, speed: float = 0.0, angle: float = 0.0) -> PHDAE:
    """A rotor with viscous friction.

        H = 1/2 J w^2,   phi' = w,   J w' = -d w + tau_a + tau_b

    States:      phi [rad], w [rad/s]
    Ports:       a, b (torque given, speed out)
    Parameters:  J [kg.m2], d [N.m.s/rad];  at the start: `speed` [rad/s], `angle` [rad]
    """
    phi, w = state("phi", unit="rad", start=angle), state("w", unit="rad/s", start=speed)
    Js, ds = parameter("J", J, unit="kg.m2"), parameter("d", d, unit="N.m.s/rad")
    return PHDAE(
        "rotational_inertia",
        states=(phi, w),
        parameters=(Js, ds),
        energies=(energy(0.5 * Js * w.sx**2),),
        E={w: Js},
        structure=(skew(phi, w, 1.0),),
        dissipation=(damping(w, ds),),
        ports=(
            Port("a", ROTATIONAL, "effort", {w: 1.0}, description="first shaft end"),
            Port("b", ROTATIONAL, "effort", {w: 1.0}, description="second shaft end"),
        ),
        description="rotor with viscous friction",
    )


def flexible_shaft(c: float = 1.0, *, d: float = 0.0, twist: float = 0.0) -> PHDAE:
    """A torsional spring with parallel damping.

        H = 1/2 c t^2,   t' = w_b - w_a,   tau_b = c t + d t',   tau_a = -tau_b   (torques on the shaft)

    States:      twist [rad];  algebraic: damper.torque [N.m], damper.speed [rad/s]
    Ports:       a, b (speed given, torque out)
    Parameters:  c [N.m/rad], d [N.m.s/rad]
    """
    t = state("twist", unit="rad", start=twist)
    cs, ds = parameter("c", c, unit="N.m/rad"), parameter("d", d, unit="N.m.s/rad")
    torque, speed = algebraic("damper.torque", unit="N.m"), algebraic("damper.speed", unit="rad/s")
    return PHDAE(
        "flexible_shaft",
        states=(t,),
        algebraics=(torque, speed),
        parameters=(cs, ds),
        energies=(energy(0.5 * cs * t.sx**2),),
        structure=(skew(torque, speed, -1.0),),
        dissipation=(damping(speed, ds),),
        ports=(
            Port("a", ROTATIONAL, "flow", {t: -1.0, torque: -1.0}, description="first shaft end"),
            Port("b", ROTATIONAL, "flow", {t: 1.0, torque: 1.0}, description="second shaft end"),
        ),
        description="torsional spring with damping",
    )
