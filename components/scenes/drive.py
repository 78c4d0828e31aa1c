"""DC motor, flexible shaft and load."""

from __future__ import annotations

from dataclasses import replace

from phfmu import Network, Scene
from phfmu.components.electrical.machines.dc_motor import dc_motor
from phfmu.components.mechanical.rotational import flexible_shaft, rotational_inertia


def drive() -> Scene:
    """A DC motor switched on at 12 V drives an inertia through a flexible shaft; linear, from rest.

    c = 20 N.m/rad, 1e-3 N.m.s/rad in the shaft; load 5e-4 kg.m2 with friction 2e-4 N.m.s/rad.
    """
    motor = dc_motor()
    motor = replace(motor, ports=tuple(replace(p, start=12.0) if p.name == "terminal" else p for p in motor.ports))
    net = Network("drive", description="DC motor, flexible shaft and load inertia")
    net.add("motor", motor)
    net.add("shaft", flexible_shaft(20.0, d=1e-3))
    net.add("load", rotational_inertia(5e-4, d=2e-4))
    net.connect("motor.shaft", "shaft.a", name="coupling_a")
    net.connect("load.a", "shaft.b", name="coupling_b")
    return Scene("drive", net, stop=0.1, step=1e-4, shown=("motor.i", "motor.w", "load.w", "shaft.twist"))
