"""A rotor whose speed is controlled."""

from __future__ import annotations

from phfmu import Event, Network, Scene
from phfmu.components.control.pi_controller import pi_controller
from phfmu.components.mechanical.rotational import rotational_inertia
from phfmu.components.mechanical.torque_source import torque_source


def speed_control(kp: float = 0.8, ki: float = 8.0) -> Scene:
    """A rotor (0.05 kg.m2, 0.01 N.m.s/rad) at 100 rad/s, loaded with 5 N.m at 0.1 s; a controller holds its speed.

    Arguments: kp [N.m.s/rad], ki [N.m/rad]

    The measured speed goes to a PI controller, its command to an actuator on the shaft: signals, which carry no power. Linear:
    J w'' + (d + kp) w' + ki w = 0 around the reference, damping ratio (d + kp) / (2 sqrt(ki J)).
    """
    J, d, speed = 0.05, 0.01, 100.0
    net = Network("speed_control", description="rotor, PI controller and actuator; load torque at 0.1 s")
    net.add("rotor", rotational_inertia(J, d=d, speed=speed))
    net.add(
        "controller",
        pi_controller(kp, ki, reference=speed, measured=speed, x=d * speed / ki, unit="rad/s", command="N.m"),
    )
    net.add("actuator", torque_source(d * speed, nominal=d * speed))
    net.connect("rotor.a", "actuator.shaft", name="shaft")
    net.signal("rotor.w", "controller.measured")
    net.signal("controller.command", "actuator.torque")
    load = Event(0.1, "rotor.b.torque", -5.0)
    return Scene("speed_control", net, stop=1.0, step=1e-3, events=(load,), shown=("rotor.w", "controller.command"))
