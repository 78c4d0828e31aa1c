"""In words: what members of a network that are stepped apart exchange, and which order follows."""

from __future__ import annotations

from phfmu.discretise.model import default_scheme
from phfmu.network.couplings.bare_columns import bare
from phfmu.network.couplings.newton import Newton
from phfmu.network.junctions.interface import interface
from phfmu.network.junctions.network import Network
from phfmu.network.members.node_values import DeclaredOffer


def order_told(network: Network) -> str:
    """What `--order` is composed and apart, for members in Python or compiled code under their usual schemes."""
    held = _held(network)
    if network.wires:
        return f"--order composed; {Newton.order} with --coupling newton: signals are held over a step"
    if held:
        which = f"{', '.join(held)} take{'s' if len(held) == 1 else ''} held inputs"
        return f"--order composed; {Newton.order} with --coupling newton: {which}"
    return (
        f"--order, composed and with --coupling newton (k = order / 2 values per step); {Newton.order} with --coupling newton "
        "--engine fmu (held values)"
    )


def exchanged(network: Network) -> dict[str, str]:
    """Junction -> what its members exchange with --coupling newton."""
    held = _held(network)
    offers = {n: DeclaredOffer(n, d) for n, d in network.members.items()}
    face = interface(network, list(offers.values()))
    places, at = [], 0
    for o in offers.values():
        places.append(slice(at, at + o.nu))
        at += o.nu
    taking = [None if n in held else o for n, o in offers.items()]
    found = bare(network, face, places, taking)
    out = {}
    for j in network.junctions:
        own = face.sums[j.name]
        values = "one held value" if any(e.member in held for e in j.ends) else "k values"
        if own.start in found.columns:
            values += " and a pair of impulses"
        elif why := found.why.get(j.name):
            values += f", no impulses ({why})"
        out[j.name] = values
    return out


def _held(network: Network) -> list[str]:
    return [n for n, d in network.members.items() if not default_scheme(d).node_values]
