"""Connectors of elements, as the system around them sees them."""

from __future__ import annotations

from dataclasses import dataclass

from phfmu.fmu.words import plain
from phfmu.ssp.structure import SINKS, SOURCES, Component, Connector, Reference, SSPError, System
from phfmu.words import meant

#: names of elements from the outermost system down to an element
Path = tuple[str, ...]
#: kind of the connectors of a signal dictionary
INOUT = "inout"


@dataclass(frozen=True)
class Place:
    """A connector of an element, as the system around it sees it: whether it gives or takes a value there."""

    path: Path
    connector: Connector
    inside: bool

    @property
    def gives(self) -> bool | None:
        """None: of a signal dictionary, which does both."""
        if self.connector.kind == INOUT:
            return None
        return self.connector.kind in (SINKS if self.inside else SOURCES)

    def __str__(self) -> str:
        return ".".join((*self.path, self.connector.name))


def connector_of(element: Component | System | Reference, name: str, where: str) -> Connector:
    """The connector `name` of an element, called `where` in messages; SSPError if there is none, or its direction is open."""
    found = element.connectors.get(name)
    if found is None:
        raise SSPError(f"'{where}' has no connector '{plain(name, 200)}'; {meant(name, element.connectors)}")
    if found.kind not in (*SINKS, *SOURCES) and not (isinstance(element, Reference) and found.kind == INOUT):
        raise SSPError(
            f"'{where}.{name}' is of the kind '{plain(found.kind, 50)}', whose direction is open; say input or output"
        )
    return found
