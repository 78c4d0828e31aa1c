"""The synchronous machine in dq-flux, abc-flux and current coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import numpy as np

from phfmu import (
    ELECTRICAL,
    PHDAE,
    ROTATIONAL,
    ClosedPair,
    Port,
    Variable,
    block,
    damping,
    energy,
    observable,
    parameter,
    skew,
    state,
)
from phfmu.components.electrical.machine_data import MachineData, machine_set
from phfmu.components.electrical.machine_init import SteadyState, steady_state
from phfmu.components.electrical.park import (
    Inductances,
    inductances,
    magnetic_energy,
    park_matrix,
    phase_inductance,
    sinc,
)

Coordinates = Literal["dq-flux", "abc-flux", "current"]


def synchronous_machine(
    machine: str | Mapping[str, Any] | MachineData = "kundur555_1q",
    *,
    coordinates: Coordinates = "dq-flux",
    start: SteadyState | None = None,
) -> PHDAE:
    """Synchronous machine with field and damper windings, all stator transients, in motor sign.

    psi' = v - R I,  p' = tau - d omega + 1/2 I^T L'(theta) I,  theta' = omega = p/J,  psi = L(theta) I

    H:  1/2 psi^T L(theta)^-1 psi + p^2/(2 J), with psi_dq = T(theta) psi and L = T^T Lhat T quadratic in "dq-flux"
    J:  J[theta, p] = 1 (skew); in "dq-flux" also J[psi_d, p] = psi_q, J[psi_q, p] = -psi_d (skew)
    R:  Ra on the stator, R_f, R_kd, .. on the rotor, d on p

    states:      psi [Wb] (d, q, 0, rotor in "dq-flux"; a, b, c, rotor in "abc-flux") or I [A] (a, b, c, rotor, "current");
                 p [kg.m2/s]; theta [rad], electrical angle of the d axis from phase a, q leads d; grows for ever
    ports:       terminal: phase voltages v given, currents i INTO the machine; field: voltage given, current out;
                 shaft: torque given, speed out; a positive torque accelerates, so tau > 0 for a generator
    parameters:  J, d, Ra, R_f, R_kd, .., Ld, Lq, L0, M_f, .., L_ff, L_fkd, ..
    observables: I[..], flux[..] (windings a, b, c, rotor), Te (air-gap torque, accelerating; negative for a generator)

    omega, J, d, tau are electrical (one pole pair) unless the set gives pole_pairs; then J, d, tau and the speed of the
    shaft port are mechanical, theta and p stay electrical, p = J omega / pole_pairs^2.
    `start` (default: 0.8 and 0.2 of rated P, Q) also gives the start values of the inputs.
    "abc-flux" keeps the phase fluxes exact; "current" is E(x) x' with E = [[L, 0, L'I], [0, 1, 0], [0, 0, 1]], order 2.
    Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, Example 4 and Appendix B; Kundur 1994, chapter 3.
    """
    data = machine_set(machine)
    builders = {"dq-flux": _dq_flux, "abc-flux": _abc_flux, "current": _current}
    if coordinates not in builders:
        raise ValueError(f"coordinates '{coordinates}' unknown; there are: {', '.join(builders)}")
    return builders[coordinates](_Common(data, start or steady_state(data)))
