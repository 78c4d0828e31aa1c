"""Energy flows of a window: from outside and from stores, through members and junctions, into stores and losses.

Each member and junction is a balance, power positive into the member:

    member:    supplied + events + residual = (stored + events) + dissipated + numerical
    junction:  sum of what it gives to members - sum of what it takes from members = junction residual

Terms are drawn in the direction in which their energy went, so that all energies are positive.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from phfmu.report.page.history import Columns, History
from phfmu.report.recording import Floats

#: kinds of nodes: balances first, then where energy comes from and goes to
MEMBER, JUNCTION, PORT, STORE, LOSS, NUMERICAL, EVENT, RESIDUAL, CREATED = (
    "member", "junction", "port", "store", "dissipated", "numerical", "event", "residual", "junction residual",
)  # fmt: skip


@dataclass(frozen=True)
class Node:
    """A member, junction or external port by its name, or an end that all share; `side`: gives (from) or takes (to)."""

    kind: str
    name: str
    side: str = ""


@dataclass(frozen=True)
class Link:
    """Energy in joule, positive, that went from one node to another."""

    source: Node
    target: Node
    energy: float


@dataclass(frozen=True)
class ComponentEnergies:
    """Energies of a component over a window in joule; None: the log has no such column for it."""

    component: str
    stored: float
    dissipated: float | None
    numerical: float | None
    supplied: float
    events: float | None
    residual: float


@dataclass(frozen=True)
class PortEnergy:
    """Energy in joule that a port (all its pairs) supplied to its component; `junction` "" for one to the outside."""

    component: str
    port: str
    junction: str
    energy: float


def component_energies(history: History) -> list[ComponentEnergies]:
    """The sums of each component. All are exactly rounded, the residual too: it is no difference of rounded sums."""
    of: dict[str, list[Columns]] = {}
    jumps: dict[str, list[Columns]] = {}
    for (component, _, _), c in history.ports.items():
        of.setdefault(component, []).append(c)
    for (_, component, _), c in history.events.items():
        jumps.setdefault(component, []).append(c)
    found = []
    for (name,), c in history.components.items():
        supplied = [_there(p, "supplied") for p in of.get(name, [])]
        changed = [_there(e, "energy_jump") for e in jumps.get(name, [])]
        used = [_there(c, column) for column in ("dH", "dissipated", "numerical")]
        stored, dissipated, numerical = (math.fsum(x) if len(x) else None for x in used)
        found.append(
            ComponentEnergies(
                name, stored or 0.0, dissipated, numerical, _fsum(supplied), _fsum(changed) if any(map(len, changed)) else None,
                _fsum([*used, *(-x for x in supplied)]),
            )
        )  # fmt: skip
    return found


def ports(history: History) -> list[PortEnergy]:
    """Energies of the ports over the window, exactly rounded."""
    found = ((key, _fsum([_there(c, "supplied")])) for key, c in history.ports.items())
    return [PortEnergy(component, port, junction, energy) for (component, port, junction), energy in found]


def created(history: History) -> dict[str, float]:
    """Energy that each junction created: the sum of what its ports supplied, exactly rounded."""
    joined: dict[str, list[Floats]] = {}
    for (_, _, junction), c in history.ports.items():
        if junction:
            joined.setdefault(junction, []).append(_there(c, "supplied"))
    return {name: _fsum(parts) for name, parts in joined.items()}


def links(history: History) -> list[Link]:
    """Links of all energies that flowed in a window; energies that are zero are no links."""
    accounts = component_energies(history)
    found = [*_through_ports(ports(history), {b.component for b in accounts}), *_in_members(accounts)]
    found += [_link(Node(JUNCTION, name), CREATED, "junctions", -energy) for name, energy in created(history).items()]
    return [link for link in found if link.energy > 0.0]


def _through_ports(passed: Sequence[PortEnergy], named: set[str]) -> Iterator[Link]:
    for p in passed:
        member = Node(MEMBER, p.component) if p.component in named else Node(PORT, p.component)
        other = Node(JUNCTION, p.junction) if p.junction else Node(PORT, f"{p.component}.{p.port}")
        yield Link(other, member, p.energy) if p.energy > 0.0 else Link(member, other, -p.energy)


def _in_members(accounts: Sequence[ComponentEnergies]) -> Iterator[Link]:
    for b in accounts:
        member, events = Node(MEMBER, b.component), b.events or 0.0
        yield _link(member, STORE, "stored", b.stored + events)
        yield _link(member, LOSS, "dissipated", b.dissipated or 0.0)
        yield _link(member, NUMERICAL, "lost by the scheme", b.numerical or 0.0)
        yield _link(member, EVENT, "events", -events)
        yield _link(member, RESIDUAL, "residual", -b.residual)


def _link(node: Node, kind: str, name: str, energy: float) -> Link:
    """Energy that a node gives to an end; where it is negative, what it takes from an end of its own, so that none does both."""
    if energy < 0.0:
        return Link(Node(kind, name, "from"), node, -energy)
    return Link(node, Node(kind, name, "to"), energy)


def _there(c: Columns, name: str) -> Floats:
    """A column without what is not there."""
    return c[name][~np.isnan(c[name])]


def _fsum(parts: Iterable[Floats]) -> float:
    return math.fsum(chain.from_iterable(x.tolist() for x in parts))
