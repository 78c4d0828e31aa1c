"""A breaker that opens a load at its current zeros."""

from __future__ import annotations

from phfmu import Event, Network, Scene
from phfmu.components.electrical.breaker import breaker
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.rlc_load import rlc_load


def breaker_opening(t_open: float = 0.02, *, chop: float = 0.0, forced: bool = False) -> Scene:
    """50 Hz grid, line 0.5 ohm and 10 mH with a breaker, load 40 ohm and 50 uF; told to open at `t_open` [s].

    Each pole opens at its next current zero, with `chop` [A] below that current already, or `forced` at once.
    """
    net = Network("breaker_opening", description="a breaker opens a load at its current zeros")
    net.add("grid", infinite_bus(325.0, 50.0, 0.3, i=10.0))
    net.add("line", breaker(0.5, 0.01, chop=chop, i=10.0, v=325.0))
    net.add("load", rlc_load(R=40.0, C=50e-6, nominal=325.0))
    net.connect("grid.terminal", "line.a", name="bus")
    net.connect("line.b", "load.terminal", name="feeder")
    command = 2.0 if forced else 0.0
    return Scene(
        "breaker_opening",
        net,
        0.04,
        2.5e-4,
        (Event(t_open, "line.command", command),),
        shown=("line.i", "load.v", "line.closed"),
    )
