"""A phase-locked loop: states that follow the angle of a three-phase voltage."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import casadi as ca

from phfmu import Variable, parameter, state
from phfmu.components.electrical.phases import ALPHA


@dataclass(frozen=True)
class PhaseLockedLoop:
    """theta [rad] and x [rad/s], its states;  speed [rad/s]: theta';  rates: of both states;  parameters: fn, kp, ki."""

    theta: Variable
    x: Variable
    speed: ca.SX
    rates: dict[Variable, Any]
    parameters: tuple[Variable, Variable, Variable]


def phase_locked_loop(v: Variable, size: Any, fn: float, kp: float, ki: float, angle: float) -> PhaseLockedLoop:
    """theta' = 2 pi fn + kp e + x,   x' = ki e,   e = -sqrt(2/3) sum_k v_k sin(theta - alpha_k) / size.

    v [V]: the phases;  size [V]: what they are measured by, their norm or a rated rms voltage, line to line;
    fn [Hz], kp [1/s], ki [1/s2];  angle [rad] of phase a at the start.  Of a balanced v of this size e = sin(angle of v - theta).
    """
    rated = parameter("fn", fn, unit="1/s", positive=True)
    gain, integral = parameter("kp", kp, unit="1/s"), parameter("ki", ki, unit="1/s2")
    theta = state("theta", start=angle, unit="rad", description="angle that follows phase a")
    x = state("x", unit="rad/s", nominal=2.0 * pi * fn, description="integral of the loop")
    e = -sqrt(2.0 / 3.0) * ca.dot(v.sx, ca.vertcat(*(ca.sin(theta.sx - a) for a in ALPHA))) / size
    speed = 2.0 * pi * rated + gain * e + x
    return PhaseLockedLoop(theta, x, speed, {theta: speed, x: integral * e}, (rated, gain, integral))
