"""Diode rectifiers with inductances on both sides: commutation with overlap."""

from __future__ import annotations

from math import pi

import casadi as ca

from phfmu import Network, Scene, time
from phfmu.components.electrical.branches import rl_branch
from phfmu.components.electrical.rectifiers import rectifier_bridge, six_pulse_bridge


def rectifier(amplitude: float = 100.0, f: float = 50.0, *, phase: float = 0.4, i0: float = 8.0) -> Scene:
    """Single-phase bridge: source with 0.05 ohm and 2 mH, load with 5 ohm and 20 mH that starts with `i0`.

    Two diodes conduct, or all four while the current of the source turns round: both pairs change at once.
    Arguments: amplitude [V], f [Hz], phase [rad] of the source; i0 [A]
    """
    net = Network("rectifier", description="single-phase diode bridge with overlap")
    voltage = amplitude * ca.cos(2 * pi * f * time + phase)
    net.add("grid", rl_branch(0.05, 2e-3, source=voltage, i=10.0, v=amplitude))
    net.add("bridge", rectifier_bridge(i=10.0, v=amplitude))
    net.add("load", rl_branch(5.0, 20e-3, i0=i0, i=10.0, v=amplitude))
    net.connect("bridge.ac", "grid.terminal", name="ac")
    net.connect("bridge.dc", "load.terminal", name="dc")
    return Scene("rectifier", net, 0.05, 5e-4, shown=("grid.current", "load.current", "bridge.blocks"))


def six_pulse(amplitude: float = 100.0, f: float = 50.0, *, phase: float = 0.4) -> Scene:
    """Three-phase bridge: source with 0.05 ohm and 2 mH a phase, load with 5 ohm and 20 mH, from rest.

    Two diodes conduct, three while one phase takes over from another.
    Arguments: amplitude [V], f [Hz], phase [rad] of the source
    """
    net = Network("six_pulse", description="three-phase diode bridge with overlap")
    voltage = amplitude * ca.vertcat(*(ca.cos(2 * pi * f * time + phase - k * 2 * pi / 3) for k in range(3)))
    net.add("grid", rl_branch(0.05, 2e-3, source=voltage, size=3, i=20.0, v=amplitude))
    net.add("bridge", six_pulse_bridge(i=20.0, v=amplitude))
    net.add("load", rl_branch(5.0, 20e-3, i=20.0, v=amplitude))
    net.junction("ac", ["bridge.ac", "grid.terminal"])
    net.connect("bridge.dc", "load.terminal", name="dc")
    return Scene("six_pulse", net, 0.02, 2.5e-4, shown=("grid.current", "load.current", "bridge.v"))
