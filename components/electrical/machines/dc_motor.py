"""Permanent-magnet DC motor."""

from __future__ import annotations

from phfmu import ELECTRICAL, PHDAE, ROTATIONAL, Port, damping, energy, observable, parameter, skew, state


def dc_motor(
    *,
    L: float = 2e-3,
    R: float = 0.4,
    J: float = 1e-4,
    k: float = 0.05,
    d: float = 1e-5,
    flux: float = 0.0,
    w: float = 0.0,
) -> PHDAE:
    """One winding, one rotor, coupled by the torque constant.

        H = phi^2/(2 L) + 1/2 J w^2,   phi' = -R i - k w + v,   J w' = k i - d w + tau,   i = phi/L

    States:      flux [Wb], w [rad/s]
    Ports:       terminal (voltage given, current out), shaft (torque given, speed out)
    Parameters:  L [H], R [ohm], J [kg.m2], k [V.s/rad], d [N.m.s/rad]
    Source:      van der Schaft, Jeltsema, Port-Hamiltonian Systems Theory, 2014, example 2.5
    """
    phi, speed = state("flux", unit="Wb", start=flux), state("w", unit="rad/s", start=w)
    Ls, Rs = parameter("L", L, unit="H"), parameter("R", R, unit="ohm")
    Js, ks, ds = (
        parameter("J", J, unit="kg.m2"),
        parameter("k", k, unit="V.s/rad"),
        parameter("d", d, unit="N.m.s/rad"),
    )
    return PHDAE(
        "dc_motor",
        states=(phi, speed),
        parameters=(Ls, Rs, Js, ks, ds),
        energies=(energy(0.5 * phi.sx**2 / Ls), energy(0.5 * Js * speed.sx**2)),
        E={speed: Js},
        structure=(skew(phi, speed, -ks.sx),),
        dissipation=(damping(phi, Rs), damping(speed, ds)),
        ports=(
            Port("terminal", ELECTRICAL, "effort", {phi: 1.0}, description="winding"),
            Port("shaft", ROTATIONAL, "effort", {speed: 1.0}, description="rotor"),
        ),
        observables=(observable("i", phi.z, unit="A", description="winding current"),),
        description="permanent-magnet DC motor",
    )
