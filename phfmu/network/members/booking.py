"""What the audit calls the energies of an instance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booking import Booking, PortKey
from phfmu.discretise.model import Model
from phfmu.signals import ordered_ports


def booking(model: Model) -> Booking:
    """Audit names of a model's ledger: members (or the model itself) and port pairs with their junctions."""
    d = model.declaration
    components = tuple(m or model.name for m in model.members)
    at = {end: name for name, ends in d.junctions for end in ends}
    pairs = []
    for p, _ in ordered_ports(d):
        if p.signal:
            continue
        short = p.name.removeprefix(p.owner + ".") if p.owner else p.name
        for j in range(p.n):
            index = None if p.size is None else j + 1
            pairs.append(PortKey(p.owner or model.name, short, index, at.get(p.name)))
    return Booking(components, tuple(pairs))


def booked(model: Model) -> NDArray[np.intp]:
    """Which pairs of its ledger are booked: all but signals, whose power is zero."""
    found = [at + j for p, at in ordered_ports(model.declaration) if not p.signal for j in range(p.n)]
    return np.array(found, int)
