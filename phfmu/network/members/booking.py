"""What the audit calls the energies of an instance."""

from __future__ import annotations

from dataclasses import dataclass

from phfmu.discretise.model import Model
from phfmu.signals import ordered_ports


@dataclass(frozen=True)
class Booking:
    """What the audit calls the ledger columns: component names, and per pair (component, port, index, junction)."""

    components: tuple[str, ...]
    pairs: tuple[tuple[str, str, int | None, str | None], ...]
    #: components whose ledger is a quadrature of port power (foreign FMUs): it closes by construction
    estimated: frozenset[str] = frozenset()
    #: whether members are coupled without the claim that junctions create no energy
    loose: bool = False


def booking(model: Model) -> Booking:
    """Audit names of a model's ledger: members (or the model itself) and port pairs with their junctions."""
    d = model.declaration
    components = tuple(m or model.name for m in model.members)
    at = {end: name for name, ends in d.junctions for end in ends}
    pairs = []
    for p, _ in ordered_ports(d):
        short = p.name.removeprefix(p.owner + ".") if p.owner else p.name
        for j in range(p.n):
            index = None if p.size is None else j + 1
            pairs.append((p.owner or model.name, short, index, at.get(p.name)))
    return Booking(components, tuple(pairs))
