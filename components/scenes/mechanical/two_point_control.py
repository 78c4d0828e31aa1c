"""A rotor that a relay keeps between two speeds."""

from __future__ import annotations

from phfmu import Network, Scene
from phfmu.components.control.relay import relay
from phfmu.components.mechanical.rotational import rotational_inertia
from phfmu.components.mechanical.torque_source import torque_source


def two_point_control(lower: float = 95.0, upper: float = 105.0) -> Scene:
    """A rotor (0.05 kg.m2, 0.02 N.m.s/rad) from 80 rad/s; a relay drives it with 4 N.m until `upper`, then not until `lower`.

    Arguments: lower, upper [rad/s]

    Exact: w = w0 + (w(t0) - w0) exp(-d (t - t0)/J), w0 = 200 rad/s driven and 0 not.
    """
    net = Network("two_point_control", description="rotor that a relay with hysteresis keeps between two speeds")
    net.add("rotor", rotational_inertia(0.05, d=0.02, speed=80.0))
    net.add("relay", relay(lower, upper, low=4.0, high=0.0, measured=80.0, unit="rad/s", command="N.m"))
    net.add("actuator", torque_source(4.0, nominal=4.0))
    net.connect("rotor.a", "actuator.shaft", name="shaft")
    net.signal("rotor.w", "relay.measured")
    net.signal("relay.command", "actuator.torque")
    return Scene("two_point_control", net, stop=2.0, step=0.02, shown=("rotor.w", "relay.command"))
