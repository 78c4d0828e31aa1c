"""Shafts that are joined and parted."""

from __future__ import annotations

from phfmu import PHDAE, ROTATIONAL, Port, Switch, algebraic, observable, parameter


def clutch(*, engaged: bool = False, torque: float = 1.0, w: float = 1.0) -> PHDAE:
    """Ideal (dog) clutch between two shaft ends, engaged and released by setting `engaged`.

        0 = w_a - w_b while it is engaged, 0 = tau while it is not;   tau_a = tau, tau_b = -tau  (torques on the clutch)

    Engaging makes the speeds equal at once and loses J1 J2/(2 (J1 + J2)) (w_a - w_b)^2, booked; the angular momentum stays.
    One that slips for a while would need Coulomb friction, which is not there.

    H:  0;  algebraic: tau [N.m], torque from a to b
    ports:       a, b: speeds given, torques out
    modes:       engaged: 1 or 0
    observables: slip, w_a - w_b [rad/s]
    `engaged`: at the start;  `torque` [N.m], `w` [rad/s]: typical torque and speed.
    """
    tau = algebraic("tau", unit="N.m", nominal=torque, description="torque from a to b")
    mode = parameter("engaged", float(engaged), min=0.0, max=1.0, description="1 engaged, 0 released")
    a = Port("a", ROTATIONAL, "flow", {}, nominal=w, description="first shaft end")
    b = Port("b", ROTATIONAL, "flow", {}, nominal=w, description="second shaft end")
    joint = Switch("clutch", tau, {a: -1.0, b: 1.0}, mode, "free", nominal=w, unit="rad/s")
    return PHDAE(
        "clutch",
        algebraics=(tau,),
        parameters=(mode,),
        ports=(a, b),
        switches=(joint,),
        observables=(observable("slip", a.u - b.u, unit="rad/s", description="speed of a against b"),),
        description="ideal clutch between two shaft ends",
    )
