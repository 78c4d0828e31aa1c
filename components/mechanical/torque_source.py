"""A torque that a signal sets."""

from __future__ import annotations

from phfmu import PHDAE, ROTATIONAL, Port, algebraic, signal_input, skew


def torque_source(torque: float = 0.0, *, nominal: float = 1.0) -> PHDAE:
    """An actuator: the torque on what its shaft is joined to is the signal `torque`.

        0 = -w + shaft.speed,   0 = tau + torque

    H:  0;  J: J[tau, w] = -1 (skew);  R: 0
    Algebraic:     tau [N.m], torque into the source; w [rad/s], speed of its shaft
    Ports:         shaft (speed given, torque INTO the source out: -torque); source: fed from inside, the work of the actuator
    Signal input:  torque [N.m];  `nominal` [N.m]: typical torque
    """
    command = signal_input("torque", torque, unit="N.m", description="torque on the shaft it is joined to")
    tau = algebraic("tau", unit="N.m", nominal=nominal, description="torque into the source")
    w = algebraic("w", unit="rad/s", description="speed of its shaft")
    return PHDAE(
        "torque_source",
        algebraics=(tau, w),
        parameters=(command,),
        structure=(skew(tau, w, -1.0),),
        ports=(
            Port("shaft", ROTATIONAL, "flow", {tau: 1.0}, description="shaft"),
            Port("source", ROTATIONAL, "effort", {w: 1.0}, source=command.sx, nominal=nominal,
                 description="torque of the actuator; its energy is the work"),
        ),
        description="torque set by a signal",
    )  # fmt: skip
