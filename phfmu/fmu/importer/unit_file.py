"""A unit as a member of a network: the file, its ports, and values before the start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

from phfmu.declare.port import Port
from phfmu.files import located
from phfmu.fmu.export.manifest import PortMap
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.archive import open_archive
from phfmu.fmu.importer.ports.port_tables import port_maps, read_sidecar, sidecar
from phfmu.fmu.importer.ports.terminal_ports import terminal_ports
from phfmu.fmu.importer.unit_interface import UnitInterface
from phfmu.gradients.quadrature import gauss_nodes
from phfmu.words import meant

#: what takes no value before the start, in words
_KINDS = {
    "output": "an output that the unit computes",
    "local": "a local variable that the unit computes",
    "calculatedParameter": "a parameter that the unit computes from others",
    "structuralParameter": "a structural parameter, which stays as it is here",
    "independent": "the time of the unit",
}


@dataclass(frozen=True, eq=False)
class UnitFile:
    """A unit that has been read; `port_maps`: its ports in the names of its variables; `starts`: values before the start.

    `left_out`: lines about what cannot be read, set or joined here.  `isolate`: it runs in a process of its own, in which a call
    may take so many s.  `source`: where it was found, if `path` is a copy.  `tolerance`: relative, of the experiment.
    """

    path: Path
    interface: UnitInterface
    port_maps: tuple[PortMap, ...]
    starts: Mapping[str, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    isolate: float | None = None
    source: str = ""
    tolerance: float | None = None

    @property
    def found(self) -> str:
        """The place at which it was found, for messages."""
        return self.source or str(self.path)

    @property
    def name(self) -> str:
        return self.interface.name

    @property
    def k(self) -> int:
        """Nodes at which it takes inputs in a step; 0: held ones only."""
        rule = gauss_nodes(self.interface.nodes)
        return rule.k if rule else 0

    @property
    def description(self) -> str:
        return self.interface.description

    @cached_property
    def ports(self) -> tuple[Port, ...]:
        """The ports in the form of a declaration."""
        return self.interface.declared_ports(self.port_maps)

    def port(self, name: str) -> Port:
        """The port called `name`; KeyError names those there are."""
        for p in self.ports:
            if p.name == name:
                return p
        raise KeyError(f"{self.found} has no port '{name}'; {meant(name, [p.name for p in self.ports])}")

    def settable_names(self) -> list[str]:
        """Variables that take a value before the start: parameters, inputs, and others that begin at one of their own."""
        return [
            n
            for n, v in self.interface.variables.items()
            if v.causality in ("parameter", "input")
            or (v.start is not None and v.causality in ("output", "local") and v.variability != "constant")
        ]

    def with_starts(self, values: Mapping[str, float]) -> UnitFile:
        """A copy with other values before the start, the name of an array for all its entries.

        KeyError names close ones if one is unknown, or says what a variable is that takes none.
        """
        known, starts = dict.fromkeys(self.settable_names()), dict(self.starts)
        entries: dict[str, list[str]] = {}
        for n in known:
            if self.interface.variables[n].size:
                entries.setdefault(n.rpartition("[")[0], []).append(n)
        for name, value in values.items():
            own = [name] if name in known else entries.get(name, [])
            if not own:
                raise KeyError(self._takes_none(name, [*known, *entries]))
            starts |= dict.fromkeys(own, value)
        return replace(self, starts=starts)

    def _takes_none(self, name: str, known: Sequence[str]) -> str:
        """Why nothing is set there."""
        there = self.interface.variables.get(name)
        if there is not None:
            kind = "constant" if there.variability == "constant" else _KINDS.get(there.causality, there.causality)
            return f"{self.found}: '{name}' is {kind}: it cannot be set"
        return f"{self.found} has no parameter, state or input '{name}'; {meant(name, known)}"


def unit_file(path: str | PathLike[str], ports: Mapping[str, Any] | None = None) -> UnitFile:
    """The unit, also beside the scene's file, with its ports.

    `ports`: tables or `PortMap`s by name.  Without them: those of `pump.ports.toml` beside `pump.fmu`, else of
    the manifest of this package, else its terminals that are pairs.  FMUError if the unit cannot be read, or its
    ports do not fit it.
    """
    path = located(Path(path))
    if path.suffix.lower() != ".fmu":
        raise FMUError(f"{path}: a unit is a file whose name ends with .fmu")
    archive = open_archive(path)
    interface, beside = archive.interface, sidecar(path)
    lines = [f"left out, cannot be read or set here: {o}" for o in (interface.left_out,) if o]
    if ports is not None:
        maps = port_maps(ports, interface, str(path))
    elif beside.is_file():
        maps = read_sidecar(beside, interface)
    elif interface.ports or archive.terminals is None:
        maps = interface.ports
    else:
        maps, others = terminal_ports(archive.terminals, interface, str(path))
        lines += others
    return UnitFile(path, interface, maps, left_out=tuple(lines))
