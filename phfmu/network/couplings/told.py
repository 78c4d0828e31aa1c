"""In words: what members of a network that are stepped apart exchange, and which order follows."""

from __future__ import annotations

from phfmu.discretise.model import default_scheme
from phfmu.network.couplings.bare_columns import Bare, bare
from phfmu.network.couplings.newton import Newton
from phfmu.network.junctions.interface import Interface, interface
from phfmu.network.junctions.network import Network
from phfmu.network.members.node_values import DeclaredOffer


def order_told(network: Network) -> str:
    """What `--order` is composed and apart, for members under their usual schemes."""
    held = _held(network)
    if network.wires:
        return f"--order composed; {Newton.order} with --coupling newton: signals are held over a step"
    if held:
        which = f"{', '.join(held)} take{'s' if len(held) == 1 else ''} held inputs"
        return f"--order composed; {Newton.order} with --coupling newton: {which}"
    return "--order, composed and with --coupling newton (k = order / 2 values per step)"


def exchanged(network: Network) -> dict[str, str]:
    """Junction -> what its members exchange with --coupling newton, and which order follows where nothing is missing."""
    held = _held(network)
    face, found = _bare(network, held)
    out = {}
    for j in network.junctions:
        own = face.sums[j.name]
        one = any(e.member in held for e in j.ends)
        values, order = ("one held value", "2") if one else ("k values", "2k")
        pair = " and a pair of impulses" if own.start in found.columns else ""
        why = "" if pair else found.why.get(j.name)
        out[j.name] = f"{values}, no impulses ({why})" if why else f"{values}{pair}, order {order}"
    return out


def kicked(network: Network) -> set[str]:
    """Members that exchange impulses; beside units, whose matrix only they know, any may."""
    if network.units:
        return set(network.declared)
    face, found = _bare(network, _held(network))
    return {e.member for j in network.junctions if face.sums[j.name].start in found.columns for e in j.ends}


def _bare(network: Network, held: list[str]) -> tuple[Interface, Bare]:
    """The columns that carry impulses where members offer what their declarations say."""
    offers = {n: DeclaredOffer(n, d) for n, d in network.declared.items()}
    face = interface(network, list(offers.values()))
    places, at = [], 0
    for o in offers.values():
        places.append(slice(at, at + o.nu))
        at += o.nu
    taking = [None if n in held else o for n, o in offers.items()]
    return face, bare(network, face, places, taking)


def _held(network: Network) -> list[str]:
    return [n for n, d in network.declared.items() if not default_scheme(d).node_values]
