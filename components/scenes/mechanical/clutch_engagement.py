"""Two rotors that a clutch joins."""

from __future__ import annotations

from phfmu import Event, Network, Scene
from phfmu.components.mechanical.clutch import clutch
from phfmu.components.mechanical.rotational import rotational_inertia


def clutch_engagement(J1: float = 2.0, J2: float = 0.7, *, speed: float = 40.0) -> Scene:
    """Rotors of 2 and 0.7 kg.m2 with friction of 1 and 0.5 N.m.s/rad, one at 40 rad/s, joined from 0.1 s to 0.3 s.

    Arguments:  J1, J2 [kg.m2]: inertias;  speed [rad/s]: of the first at the start

    Engaging loses J1 J2/(2 (J1 + J2)) w^2, w the slip at 0.1 s; the speeds are exponentials in between.
    """
    net = Network("clutch_engagement", description="two rotors, joined by a clutch and parted again")
    net.add("driver", rotational_inertia(J1, d=1.0, speed=speed))
    net.add("clutch", clutch(torque=speed, w=speed))
    net.add("load", rotational_inertia(J2, d=0.5))
    net.connect("driver.b", "clutch.a", name="input")
    net.connect("clutch.b", "load.a", name="output")
    events = Event(0.1, "clutch.engaged", 1.0), Event(0.3, "clutch.engaged", 0.0)
    return Scene(
        "clutch_engagement", net, stop=0.5, step=5e-3, events=events, shown=("driver.w", "load.w", "clutch.slip")
    )
