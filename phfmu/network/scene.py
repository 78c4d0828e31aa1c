"""Scenes: a model or network with its run: stop, step and events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from phfmu.declare.phdae import PHDAE, require_declaration
from phfmu.declare.shape import Shape
from phfmu.html import grid
from phfmu.network.network import Network
from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.fmu.importer.reader import FMUInstance
    from phfmu.fmu.importer.unit_file import UnitFile


@dataclass(frozen=True)
class Event:
    """At time t the parameter or input `name` (e.g. `fault.G`, `gen.shaft.torque`) takes `value`."""

    t: float
    name: str
    value: float


@dataclass(frozen=True, repr=False)
class Scene:
    """The run of `phfmu run NAME`: stop time and step in seconds, events of the first kind; the grid lands on them.

    `restart`: damping steps after each event, see `phfmu.runs.march.restart`.  `notes`: what of the file that the scene was
    read from is not in it, a line each.  `kept`: what that file says besides, for who writes it again.  `shown`: names or
    patterns of the signals that a picture of its run has where none are named.  `description`: that of the system if empty.
    `steady`: the operating point (`phfmu.operating.NetworkPoint`) that the system starts in, if `phfmu run` is to move it to
    where steps of its scheme and length stay.
    """

    name: str
    system: PHDAE | Network
    stop: float
    step: float
    events: tuple[Event, ...] = ()
    description: str = ""
    restart: int = 0
    notes: tuple[str, ...] = ()
    kept: object = None
    shown: tuple[str, ...] = ()
    steady: object = None

    def __post_init__(self) -> None:
        if not isinstance(self.system, Network):
            require_declaration(self.system, f"scene {self.name}")
        if not self.description:
            object.__setattr__(self, "description", self.system.description)

    def __repr__(self) -> str:
        events = f", {counted(len(self.events), 'event')}" if self.events else ""
        return f"<Scene {self.name}: {self.stop:g} s in steps of {self.step:g} s{events}; {repr(self.system)[1:-1]}>"

    def _repr_html_(self) -> str:
        """For notebooks: the run, its events, what is run."""
        events = [(f"{e.t:g} s", e.name, f"{e.value:.6g}") for e in self.events]
        run = f"{self.name}: {self.stop:g} s in steps of {self.step:g} s"
        return grid(run, ("event at", "sets", "to"), events) + self.system._repr_html_()

    @property
    def units(self) -> dict[str, UnitFile]:
        """Members that are FMUs; with such the scene is no one PHDAE."""
        return self.system.units if isinstance(self.system, Network) else {}

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The shapes of its declared members, by the names of a run."""
        if not isinstance(self.system, Network):
            return self.system.shapes
        return tuple(s.prefixed(name) for name, member in self.system.declared.items() for s in member.shapes)

    def declaration(self) -> PHDAE:
        """The scene as one PHDAE; ConnectionError names units in it."""
        return self.system.compose() if isinstance(self.system, Network) else self.system


def fmu_scene(unit: FMUInstance) -> Scene:
    """Stop and step of the unit's default experiment (1 s, 1 ms where it has none)."""
    face = unit.interface
    step = face.step or 1e-3
    stop = face.stop if face.stop is not None else 1.0
    return Scene(unit.name, PHDAE(unit.name), stop, step, description=face.description)
