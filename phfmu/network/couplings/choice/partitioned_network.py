"""The exchange of members that are stepped apart, and the order that follows; in words."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cached_property
from math import inf
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import _sx
from phfmu.events.event_plan import at_instant
from phfmu.network.couplings.newton import Newton
from phfmu.network.couplings.signals.sampled_signals import ORDER_OF_EVENTS
from phfmu.network.interface.bare_columns import BareColumns, bare
from phfmu.network.interface.interface import Interface, interface
from phfmu.network.interface.relations import bent
from phfmu.network.members.node_values import DeclaredOffer
from phfmu.network.network import Network
from phfmu.network.wires import Wire
from phfmu.terms.extraction.extract import extract
from phfmu.terms.port_impulses import Impulse

if TYPE_CHECKING:
    from phfmu.fmu.importer.unit_file import UnitFile


class PartitionedNetwork:
    """A network whose members are stepped apart."""

    def __init__(self, network: Network, inside: Collection[str] = ()):
        """`inside`: members whose events happen inside their steps anyway: exported as units, or in several parts a step."""
        self.network = network
        self._barred = self._bars(inside)
        #: members that take one held value a step
        self.held = [n for n, u in network.units.items() if not u.k]
        if self._barred:
            self.held += [n for n, d in network.declared.items() if d.switches]
        #: members with state events that do so -> why
        self.landing_alone = self._landing_alone(inside)
        self.held += self.landing_alone

    def _bars(self, inside: Collection[str]) -> str:
        """Why the events of all members are not looked at as one; "" if they may be, or if there is no need."""
        network = self.network
        if not any(d.switches or d.state_events for d in network.declared.values()):
            return ""
        if network.wires:
            return "signals between members are held over a step"
        others = [*network.units, *inside]
        return f"{others[0]} has steps of its own" if others else bent(network, network.declared)

    def _landing_alone(self, inside: Collection[str]) -> dict[str, str]:
        """Members whose state events are looked at inside their steps; the rule of `InterfaceUnknowns`, for declarations."""
        network = self.network
        own = {n: d for n, d in network.declared.items() if d.state_events and not d.switches}
        reading = [n for n, d in own.items() if reads_others(d)]
        if not own or (not self._barred and (reading or any(d.switches for d in network.declared.values()))):
            return {}
        if network.wires:
            return dict.fromkeys(own, f"whose events happen inside its step, since {self._barred}")
        alone = dict.fromkeys(reading, f"whose guards read what others give, and {self._barred}")
        alone |= {n: "whose events happen inside its step" for n in own if n in inside}
        self.held += alone
        face, found = self._columns_with_impulses()
        for j in network.junctions:
            if face.sums[j.name].start in found.columns:
                bare_there = "that do not go with the impulses of a bare node"
                alone |= {e.member: bare_there for e in j.ends if e.member in own and e.member not in alone}
        self.held = [n for n in self.held if n not in alone]
        return alone

    @cached_property
    def wires(self) -> list[Wire]:
        """Signals that are held over a step."""
        return held_wires(self.network, self.holding(lambda _: True))

    def holding(self, at_nodes: Callable[[str], bool]) -> set[str]:
        """Members whose signals are held over a step: with state events, held inputs, or not stepped `at_nodes`."""
        declared = self.network.declared.items()
        return {*self.held, *(n for n, d in declared if d.state_events or not at_nodes(n))}

    @property
    def events_by_signals(self) -> list[str]:
        """Members with state events that take or give held signals."""
        ends = {n for w in self.network.wires for n in (w.source, w.target)}
        return [n for n in self.landing_alone if n in ends]

    def order(self) -> str:
        """The meaning of `--order`, composed and apart."""
        held, units = self.held, self.network.units
        if self.network.wires:  # which say more than that events happen inside steps then
            held = [n for n in held if n not in self.landing_alone]
        which = f"{', '.join(held)} take{'s' if len(held) == 1 else ''} held inputs"
        if units:
            most = min(Newton.order if held or self.wires else inf, *(2 * (u.k or 1) for u in units.values()))
            return f"at most {most:g} with --coupling newton{f'; {which}' if held else ', that of its units'}"
        if self.events_by_signals:
            return (
                f"--order composed; {ORDER_OF_EVENTS} apart: signals are held over a step, and the events of "
                f"{', '.join(self.events_by_signals)} follow them or are told by them{f'; {which}' if held else ''}"
            )
        if held:
            return f"--order composed; {Newton.order} with --coupling newton: {which}"
        if self.wires:
            return f"--order composed; {Newton.order} with --coupling newton: signals are held over a step"
        return "--order, composed and with --coupling newton (k = order / 2 values per step)"

    def exchanged(self) -> dict[str, str]:
        """Junction -> what its members exchange with --coupling newton, and which order follows where nothing is missing."""
        face, found = self._bare
        out = {}
        for j in self.network.junctions:
            own = face.sums[j.name]
            one = list(dict.fromkeys(e.member for e in j.ends if e.member in self.held))
            values, order = ("one held value", "2") if one else ("k values", "2k")
            pair = " and a pair of impulses" if own.start in found.columns else ""
            why = "" if pair else found.why.get(j.name)
            text = f"{values}, no impulses ({why})" if why else f"{values}{pair}, order {order}"
            out[j.name] = "; ".join([text, *map(self.why_held, one)])
        return out

    def kicked(self, projected: bool = False) -> set[str]:
        """Members that exchange impulses; if the start is to be `projected`, all that take some."""
        if projected:
            declared = self.network.declared.items()
            return {n for n, d in declared if n not in self.held and not d.switches and DeclaredOffer(n, d).kicked}
        kicked = self.with_impulses()
        return {e.member for j in self.network.junctions if j.name in kicked for e in j.ends}

    def with_impulses(self) -> set[str]:
        """Junctions that exchange impulses."""
        face, found = self._bare
        return {j.name for j in self.network.junctions if face.sums[j.name].start in found.columns}

    def without_impulses(self) -> set[str]:
        """Junctions of inductive branches alone that need impulses and exchange none."""
        return {name for name, why in self._bare[1].why.items() if why}

    def why_held(self, member: str) -> str:
        """Why a member takes one value a step."""
        unit, called = self.network.units.get(member), member or "the composed member"
        if member in self.landing_alone:
            own = member or "the composed member"
            return f"{own} has state events {self.landing_alone[member]}: it takes the mean of its inputs"
        if unit is not None and unit.interface.energy:
            return f"{member} was exported without inputs at nodes (--node-inputs, --order 4)"
        if unit is not None:
            return f"{member} is a unit of another tool, which takes held inputs"
        return f"{called} has ideal switches, whose modes change within its step: it takes the mean of its inputs"

    @cached_property
    def _bare(self) -> tuple[Interface, BareColumns]:
        return self._columns_with_impulses()

    def _columns_with_impulses(self) -> tuple[Interface, BareColumns]:
        """The columns that carry impulses where members that are not held offer what their declarations, or manifests, say."""
        network = self.network
        offers = {
            n: FileOffer(n, network.units[n]) if n in network.units else DeclaredOffer(n, network.declared[n])
            for n in network.members
        }
        face = interface(network, list(offers.values()))
        places, at = [], 0
        for o in offers.values():
            places.append(slice(at, at + o.nu))
            at += o.nu
        switched = {n for n, d in network.declared.items() if d.switches}
        taking = [None if n in self.held or n in switched or not o.ports else o for n, o in offers.items()]
        return face, bare(network, face, places, taking)


def reads_others(declaration: PHDAE) -> bool:
    """Whether guards read algebraic variables or inputs, which the polynomial of a member's states does not tell."""
    terms = extract(declaration)
    there = ca.vertcat(*(v.sx for v in declaration.algebraics), *(ca.vec(p.u) for p in declaration.ports if p.external))
    guards = [(e.guard.name, ca.SX(_sx(e.guard.expr))) for e in declaration.state_events]
    return any(ca.depends_on(g, there) for g in at_instant(terms, guards))


def held_wires(network: Network, held: Collection[str]) -> list[Wire]:
    """Signals that are held over a step: from and to `held` members, and units without their values at nodes."""
    there = network.units
    given = {n: d.interface.sent if d.k else {} for n, d in there.items()}
    taken = {n: d.interface.taken if d.k else {} for n, d in there.items()}
    return [
        w
        for w in network.wires
        if {w.source, w.target} & set(held)
        or (w.source in there and w.output not in given[w.source])
        or (w.target in there and w.input not in taken[w.target])
    ]


def circling_units(network: Network, wires: Collection[Wire]) -> list[str]:
    """Units of other tools whose output comes back to them by `wires`, over other members or at once."""
    after: dict[str, set[str]] = {}
    for w in wires:
        after.setdefault(w.source, set()).add(w.target)

    def comes_back(name: str) -> bool:
        seen, ahead = set[str](), set(after.get(name, ()))
        while ahead - seen:
            seen |= ahead
            ahead = {target for member in ahead for target in after.get(member, ())}
        return name in seen

    return [n for n, unit in network.units.items() if not unit.interface.energy and comes_back(n)]


class FileOffer:
    """The offer of a unit by its manifest. Its matrix is not known before it runs: all of its impulses may be coupled."""

    def __init__(self, name: str, file: UnitFile):
        from phfmu.fmu.importer.ports.node_exchange import impulse_ports

        self.name, self.nu = name, 0
        self.ports = {p.port: p for p in impulse_ports(file.port_maps)}
        self.places = {}
        for p in file.port_maps:
            self.places[p.name] = slice(self.nu, self.nu + len(p.inputs))
            self.nu += len(p.inputs)
        self.kicked = [j for p in self.ports.values() if p.kind is not Impulse.NONE for j in p.inputs]

    def jump(self) -> NDArray[np.float64]:
        n = len(self.kicked)
        return np.eye(n) + np.ones((n, n))
