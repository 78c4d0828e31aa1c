"""The interface of a unit as it describes itself: its variables and abilities, and the ports of the manifest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from phfmu.declare.expressions.units import PhysicalUnit
from phfmu.declare.port import Port
from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.export.variables import FMUError


@dataclass(frozen=True, slots=True)
class Scalar:
    """A number, or entry `entry` of an array of `size` numbers that share a value reference (size 0: no array).

    `type`: that of FMI 3.0; its value is read and set as a float.  `has_unit`: False where `unit` is 1 since none is told.
    """

    name: str
    reference: int
    causality: str
    start: float | None = None
    unit: str = "1"
    nominal: float = 1.0
    description: str = ""
    type: str = "Float64"
    entry: int = 0
    size: int = 0
    variability: str = ""
    has_unit: bool = True


@dataclass(frozen=True)
class UnitInterface:
    """A unit for Co-Simulation.  `ports` and `energy` are those of the manifest, empty in foreign units.

    `left_out`: what cannot be read or set here, in words. `scheme`: how it steps, with the order, where it says so. `nodes`,
    `weights`: places on [0, 1] and weights of the nodes at which ports take inputs; empty without such inputs. `impulses`:
    inputs of which impulses are taken, in the order of the matrix `jump`. `derived`: names of `states`, of values `ofStep` and
    `now` that have derivatives by states and parameters; empty in units that tell none. `taken`, `sent`: signal -> its names at
    the nodes of a step. `serialises`: its saved states may become bytes. `one_step`: it says that all of its steps have to be
    equal; `one_instance`: a process can have one of it; `tool`: it needs a tool of its maker. `event_mode`, `early_return`: it
    has an Event Mode, and may end steps early, where an importer allows that; `clocks`: how many it has.
    """

    version: str
    name: str
    identifier: str
    token: str
    variables: dict[str, Scalar]
    saves: bool
    serialises: bool
    derivatives: bool
    start: float = 0.0
    stop: float | None = None
    step: float | None = None
    description: str = ""
    ports: tuple[PortMap, ...] = ()
    energy: dict[str, str] = field(default_factory=dict)
    scheme: str = ""
    nodes: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()
    impulses: tuple[str, ...] = ()
    jump: str = ""
    derived: dict[str, tuple[str, ...]] = field(default_factory=dict)
    taken: dict[str, tuple[str, ...]] = field(default_factory=dict)
    sent: dict[str, tuple[str, ...]] = field(default_factory=dict)
    left_out: str = ""
    units: dict[str, PhysicalUnit] = field(default_factory=dict)
    one_step: bool = False
    one_instance: bool = False
    tool: bool = False
    event_mode: bool = False
    early_return: bool = False
    clocks: int = 0

    def scalars(self, names: list[str] | tuple[str, ...], what: str) -> list[Scalar]:
        """The variables; FMUError names those there are not."""
        from difflib import get_close_matches

        missing = [n for n in names if n not in self.variables]
        if missing:
            close = get_close_matches(missing[0], self.variables, 5)
            hint = f"; did you mean {', '.join(close)}?" if close else ""
            raise FMUError(f"{self.name} has no {what} '{missing[0]}'{hint}")
        return [self.variables[n] for n in names]

    def declared_ports(self, ports: Sequence[PortMap] | None = None) -> tuple[Port, ...]:
        """The ports as a declaration has them, for a network to join; they act on no visible variables."""
        return tuple(
            Port(
                p.name, p.domain, p.given, {}, len(p.inputs) if p.vector or len(p.inputs) > 1 else None,
                start=[p.input_sign * (self.variables[n].start or 0.0) + 0.0 for n in p.inputs],
                nominal=[abs(p.input_sign) * self.variables[n].nominal for n in p.inputs],
                description=self.variables[p.inputs[0]].description if p.inputs else "",
            )
            for p in (self.ports if ports is None else ports)
        )  # fmt: skip
