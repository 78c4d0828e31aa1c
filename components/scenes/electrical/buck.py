"""A step-down converter."""

from __future__ import annotations

import casadi as ca

from phfmu import Event, Network, Scene
from phfmu.components.electrical.branches import rc_node, rl_link
from phfmu.components.electrical.sources import voltage_source
from phfmu.components.electrical.switches import chopper, diode


def buck(duty: float = 0.4, *, R: float = 4.0, f: float = 20e3, later: float | None = 0.6) -> Scene:
    """24 V, chopper, diode, 0.05 ohm and 100 uH, 47 uF beside R; the duty changes to `later` at 1.5 ms.

    The diode takes the current over where the chopper cuts it, and blocks where it falls to zero: with a large R the
    conduction is discontinuous.  On average v = duty (24 V + drop) - drop with the drop of the diode, ideally 0.1 V.
    Arguments: duty and later [1], R [ohm], f [Hz] of the switching
    """
    net = Network("buck", description="step-down converter: chopper, diode, filter")
    net.add("source", voltage_source(ca.SX(24.0), v=24.0, i=3.0))
    net.add("ground", voltage_source(ca.SX(-0.1), v=24.0, i=3.0))
    net.add("chopper", chopper(f, duty=duty, i=3.0, v=24.0))
    net.add("diode", diode(i=3.0, v=24.0))
    net.add("coil", rl_link(0.05, 100e-6, i=3.0, v=24.0))
    net.add("load", rc_node(R, 47e-6, i=3.0, v=24.0))
    net.junction("supply", ["source.terminal", "chopper.a"])
    net.junction("return", ["ground.terminal", "diode.a"])
    net.junction("switched", ["chopper.b", "diode.b", "coil.a"])
    net.connect("load.terminal", "coil.b", name="output")
    events = () if later is None else (Event(1.5e-3, "chopper.duty", later),)
    return Scene("buck", net, 3e-3, 5e-6, events, shown=("coil.current", "load.voltage", "chopper.duty"))
