"""Junctions: ports that meet, and connections that cannot be made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

from phfmu.declare.error import Refusal
from phfmu.declare.port import Given, Port
from phfmu.signals import of_member

Kind = Literal["0", "1"]
SHARED: dict[Kind, Given] = {"0": "effort", "1": "flow"}
#: the kind of a junction whose ports share this
KIND: dict[Given, Kind] = {shared: kind for kind, shared in SHARED.items()}


class ConnectionError(Refusal):
    """A connection that cannot be made; `entry` names the sides."""


class WithPorts(Protocol):
    """A member, as far as junctions look at it: a declaration or a unit."""

    def port(self, name: str) -> Port: ...


@dataclass(frozen=True)
class End:
    """One side of a connection: port `port` of member `member`."""

    member: str
    port: str

    def __str__(self) -> str:
        return of_member(self.member, self.port)


@dataclass(frozen=True)
class Junction:
    """Ports that meet: kind "0" (common effort) or "1" (common flow)."""

    name: str
    kind: Kind
    ends: tuple[End, ...]

    @property
    def shared(self) -> Given:
        """What all its ports have in common."""
        return SHARED[self.kind]

    def ports(self, members: Mapping[str, WithPorts]) -> dict[End, Port]:
        """The ports that meet, in the order of the ends."""
        return {e: members[e.member].port(e.port) for e in self.ends}
