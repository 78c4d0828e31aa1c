"""An induction motor started across a line."""

from __future__ import annotations

from phfmu import Event, Network, Scene
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.machines.induction_machine import induction_machine
from phfmu.components.electrical.rl_line import rl_line


def motor_start(*, load: float = 198.0, double_cage: bool = False) -> Scene:
    """A motor of 50 hp, 460 V starts from rest across a line; it is loaded with `load` [N.m] at 0.8 s.

    The line has R = 10 mohm and L = 0.1 mH per phase, so that its start lowers the voltage; motor and line meet at a node
    without capacitor.  `double_cage` gives the rotor a second cage (1 ohm, 0.4 mH), which raises the torque at standstill.
    Source of the data: Krause et al. 2013, chapter 6; the rated torque is 198 N.m.
    """
    cages = ((0.228, 0.8e-3), *(((1.0, 0.4e-3),) if double_cage else ()))
    net = Network("motor_start", description="induction motor of 50 hp across a line, from rest, then loaded")
    net.add("grid", infinite_bus(375.6, 60.0, i=80.0))
    net.add("line", rl_line(0.01, 1e-4, v=375.6))
    net.add("motor", induction_machine(cages=cages))
    net.junction("bus1", ["grid.terminal", "line.a"])
    net.junction("bus2", ["line.b", "motor.terminal"])
    events = (Event(0.8, "motor.shaft.torque", -load),)
    return Scene("motor_start", net, stop=1.2, step=2e-4, events=events, shown=("motor.slip", "motor.Te", "motor.i"))
