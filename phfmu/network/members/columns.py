"""Result columns of a model, read from an instance's signals, and the names of its energies in the audit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booking import Booking, PortKey, TermKey
from phfmu.discretise.accounts import Accounts
from phfmu.discretise.model import Model
from phfmu.signals import Quantity, SignalKind, ordered_ports, quantities

Array = NDArray[np.float64]


class SignalColumns:
    """Names and gather tables of every calculated variable (no parameters, inputs or time)."""

    def __init__(self, model: Model, layout: dict[str, slice]):
        place = {block: where.start for block, where in layout.items()}
        chosen: list[Quantity] = [q for q in quantities(model) if q.block in place and q.causality != "independent"]
        self.names = [q.name for q in chosen]
        self._chosen = chosen
        self._known: dict[tuple[str, ...], list[tuple[str, slice]]] = {}
        self._blocks = list(layout)
        entries = [place[q.block] + q.first + np.arange(q.count) for q in chosen]
        self._first = np.array([own[0] for own in entries], int)
        #: columns that are sums of several entries
        self._sums = [(i, own) for i, own in enumerate(entries) if len(own) > 1]

    @property
    def units(self) -> dict[str, str]:
        return {q.name: q.unit for q in self._chosen}

    @property
    def kinds(self) -> dict[str, SignalKind]:
        return {q.name: q.kind for q in self._chosen}

    def pick(self, signals: Array) -> Array:
        """Rows of signals -> rows of columns."""
        rows = signals[:, self._first]
        for i, own in self._sums:
            rows[:, i] = np.add.reduce(np.ascontiguousarray(signals[:, own]), axis=1)
        return rows

    def some(self, instance: Any, names: tuple[str, ...]) -> Array:
        """A few columns at the present time, from the blocks they are in."""
        if names not in self._known:
            self._known[names] = [self._place(n) for n in names]
        return np.array([float(instance.signal(block)[place].sum()) for block, place in self._known[names]])

    def place(self, name: str) -> tuple[int, int]:
        """First entry and number of the entries of a row of signals whose sum a column is."""
        i = self.names.index(name)
        return int(self._first[i]), self._chosen[i].count

    def _place(self, name: str) -> tuple[str, slice]:
        q = next(q for q in self._chosen if q.name == name)
        return q.block, slice(q.first, q.first + q.count)

    def now(self, instance: Any) -> Array:
        """The columns at the present time."""
        signals = instance.signals()
        return self.pick(np.concatenate([signals[b] for b in self._blocks])[None])[0]


def booking(model: Model, constants: tuple[float, ...]) -> Booking:
    """Audit names of a model's ledger: members (or the model itself) and port pairs with their junctions.

    constants: by component, what of H is constant
    """
    d = model.declaration
    accounts = Accounts.of(model.members)
    members = model.members if accounts is None else [model.members[i] for i in accounts.first]
    components = tuple(m or model.name for m in members)
    at = {end: name for name, ends in d.junctions for end in ends}
    pairs = []
    for p, _ in ordered_ports(d):
        if p.signal:
            continue
        short = p.name.removeprefix(p.owner + ".") if p.owner else p.name
        for j in range(p.n):
            index = None if p.size is None else j + 1
            pairs.append(PortKey(p.owner or model.name, short, index, at.get(p.name)))
    terms = () if accounts is None else accounts.terms
    keys = tuple(TermKey(a.component or model.name, a.term, a.stores) for a in terms)
    return Booking(components, tuple(pairs), constants=constants, terms=keys)


def booked(model: Model) -> NDArray[np.intp]:
    """The pairs of its ledger that are booked: all but signals, whose power is zero."""
    found = [at + j for p, at in ordered_ports(model.declaration) if not p.signal for j in range(p.n)]
    return np.array(found, int)
