"""Networks with units in which the declared members that meet each other are one composed member.

The composed member has no name: it calls its variables, ports and energies as the whole network does (`signals.of_member`).
Junctions and signals between its members are inside it; those that reach a unit, or a member that is stepped apart, stay.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

from phfmu.declare.phdae import PHDAE
from phfmu.network.compose import compose
from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork
from phfmu.network.junction import End, Junction
from phfmu.network.network import Network
from phfmu.network.wires import Wire, in_order
from phfmu.signals import of_member
from phfmu.words import first_few

if TYPE_CHECKING:
    from phfmu.fmu.importer.unit_file import UnitFile

#: the name of the composed member
COMPOSED = ""


def gathered(network: Network, apart: Collection[str] = ()) -> Network:
    """`network` with its declared members, but those `apart`, that meet others of them at a junction or by a signal as one
    member; `network` itself where there are none, and where it has no units: then it is stepped apart since that is asked for.

    Members that exchange impulses with others stay apart, too: a composed member could not take them at its ports.
    """
    bare = PartitionedNetwork(network)
    inside = _inside(network, apart, bare) if network.units else set()
    if not inside:
        return network
    junctions = [j for j in network.junctions if _members(j) <= inside]
    wires = [w for w in network.wires if {w.source, w.target} <= inside]
    parts = {n: d for n, d in network.declared.items() if n in inside}
    whole = compose(network.name, parts, junctions, network.description, wires)
    if bare.without_impulses() & {j.name for j in junctions} and _loses(whole):
        return network
    members: dict[str, PHDAE | UnitFile] = {}
    for name, member in network.members.items():
        members |= {COMPOSED: whole} if name in inside else {name: member}
    return replace(
        network,
        members=members,
        junctions=[_outer(j, inside) for j in network.junctions if not _members(j) <= inside],
        wires=in_order(members, [_wire(w, inside) for w in network.wires if not {w.source, w.target} <= inside]),
        gathered_from=network,
    )


def composed_members(network: Network) -> list[str]:
    """Names of those that are one member of a gathered network."""
    found = network.gathered_from
    return [] if found is None else [n for n in found.members if n not in network.members]


def composed_words(network: Network) -> str:
    """A line about the members of a gathered network that are one; "" if none are."""
    names = composed_members(network)
    return f"composed to one member: {first_few(names)} (--member NAME=ENGINE steps one of them apart)" if names else ""


def junction_words(network: Network) -> dict[str, str]:
    """Junction -> what its members exchange with --coupling newton, or that it is composed."""
    words = PartitionedNetwork(gathered(network)).exchanged()
    return {j.name: f"newton: {words[j.name]}" if j.name in words else "composed" for j in network.junctions}


def _members(junction: Junction) -> set[str]:
    return {e.member for e in junction.ends}


def _inside(network: Network, apart: Collection[str], bare: PartitionedNetwork) -> set[str]:
    """Members to compose: declared ones that meet another one, none of which exchanges impulses with what is outside."""
    own = set(network.declared) - set(apart)
    taking = apart or any(p.impulses for u in network.units.values() for p in u.port_maps)
    impulses = bare.with_impulses() if taking else ()
    kicked = [_members(j) for j in network.junctions if j.name in impulses]
    while True:
        pairs = [*map(_members, network.junctions), *({w.source, w.target} for w in network.wires)]
        inside = {name for pair in pairs if len(pair) > 1 and pair <= own for name in pair}
        crossed = {name for pair in kicked if not pair <= inside for name in pair & inside}
        if not crossed:
            return inside
        own -= crossed


def _loses(whole: PHDAE) -> bool:
    """Whether steps project states at nodes inside, which is booked for one model that is the whole run."""
    from phfmu.terms.bare import Remedy, bare_nodes
    from phfmu.terms.extraction.extract import extract

    return any(n.remedy is Remedy.PROJECTION for n in bare_nodes(extract(whole)))


def _outer(junction: Junction, inside: Collection[str]) -> Junction:
    ends = (End(COMPOSED, str(e)) if e.member in inside else e for e in junction.ends)
    return replace(junction, ends=tuple(ends))


def _wire(wire: Wire, inside: Collection[str]) -> Wire:
    if wire.source in inside:
        wire = replace(wire, source=COMPOSED, output=of_member(wire.source, wire.output))
    if wire.target in inside:
        wire = replace(wire, target=COMPOSED, input=of_member(wire.target, wire.input))
    return wire
