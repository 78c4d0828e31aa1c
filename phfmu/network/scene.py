"""Scenes: a model or network with its run: stop, step and events."""

from __future__ import annotations

from dataclasses import dataclass

from phfmu.declare.phdae import PHDAE
from phfmu.network.network import Network


@dataclass(frozen=True)
class Event:
    """At time t the parameter or input `name` (e.g. `fault.G`, `gen.shaft.torque`) takes `value`."""

    t: float
    name: str
    value: float


@dataclass(frozen=True)
class Scene:
    """What `phfmu run NAME` runs: stop time and step in seconds, events of the first kind; the grid lands on them.

    `restart`: damping steps after each event, see `phfmu.network.restart`.
    """

    name: str
    system: PHDAE | Network
    stop: float
    step: float
    events: tuple[Event, ...] = ()
    description: str = ""
    restart: int = 0

    def declaration(self) -> PHDAE:
        """The scene as one PHDAE."""
        return self.system.compose() if isinstance(self.system, Network) else self.system
