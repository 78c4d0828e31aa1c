"""Members that are ideal switches and nothing else, as columns and rows of what coupled members exchange; who may have such."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from phfmu.declare.phdae import PHDAE
from phfmu.events.switch_system import UndeterminedDirection
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.shared_jumps import SharedJumps
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.node_values import DeclaredOffer
from phfmu.network.members.relation import RelationInstance, is_relation
from phfmu.network.network import Network
from phfmu.terms.port_impulses import Impulse

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


def all_together(joined: CoupledMembers, shared: SharedJumps) -> bool:
    """Whether members land with all others by the events of the composed declaration: some have ideal switches, or guards that
    read what others give, in steps of order 4 and 6 or beside jumps that act on others.

    Their members that are nothing but switches are made relations then.  Raises ValueError where that is needed and barred.
    """
    switched = [m for m in joined.members if isinstance(m, EngineMember) and m.model.modes is not None]
    reading = any(isinstance(m, EngineMember) and _reads(m, shared) for m in joined.members)
    if not switched and not reading:
        return False
    barred = _barred(joined)
    if barred and (bound := next((m.between_inputs for m in switched if m.between_inputs), "")):
        raise ValueError(f"{bound} ({barred})")
    fed = dict(zip(joined.members, (bool((joined.face.column[p] >= 0).all()) for p in joined.places), strict=True))
    relations = [m for m in switched if fed[m] and is_relation(m.model.modes.modes)]  # type: ignore[union-attr]
    if barred or not (reading or relations or all(m.model.step.k > 1 for m in switched)):
        return False
    for m in relations:
        m.become(RelationInstance(m.model))
    for m in joined.members:
        m.together = m.model.events is not None  # type: ignore[attr-defined]
    return True


def _reads(m: EngineMember, shared: SharedJumps) -> bool:
    """Whether guards of a member read what others give, so that no polynomial of its own tells where they are zero."""
    return m.model.events is not None and not m.guards_states and (m.model.step.k > 1 or m.name in shared.of)


def _barred(joined: CoupledMembers) -> str:
    """Why the events of all members are not looked at as one; "" if they are."""
    members = joined.members
    if joined.network.wires:
        return "signals between members are held over a step"
    for m in members:
        if not isinstance(m, EngineMember):
            return f"{m.name} is no member that an engine steps"
        if not m.model.scheme.node_values or m.parts != 1:
            return f"{m.name} takes no inputs at the nodes of its steps"
    if words := bent(joined.network, {m.name: m.model.declaration for m in members}):  # type: ignore[attr-defined]
        return words
    orders = {m.name: m.model.scheme.order for m in members}  # type: ignore[attr-defined]
    if len(set(orders.values())) > 1:
        return f"members have different orders ({', '.join(f'{n}: {o}' for n, o in orders.items())})"
    return ""


def bent(network: Network, declared: Mapping[str, PHDAE]) -> str:
    """A port at a junction of the network whose impulses change what it conducts, in words; "" if there is none."""
    offers = {n: DeclaredOffer(n, d).ports for n, d in declared.items() if not d.switches}
    for end in (e for j in network.junctions for e in j.ends):
        port = offers.get(end.member, {}).get(end.port)
        if port is not None and port.kind is not Impulse.NONE and not port.linear:
            return f"{end} may be at a bare node, where impulses do not land with the modes of switches"
    return ""


class Relations:
    """Columns of the unknowns of relations, from column `first` on, after those of junctions and signals."""

    def __init__(self, joined: CoupledMembers, first: int):
        self._joined, self.first = joined, first
        self._own: list[tuple[int, RelationInstance, Ints]] = []
        at = first
        for i, m in enumerate(joined.members):
            if isinstance(m, EngineMember) and isinstance(m.instance, RelationInstance):
                n = m.instance.na
                self._own.append((i, m.instance, np.arange(at, at + n)))
                at += n
        self._n = at
        #: directions that no row determines in the present modes, with their columns
        self.undetermined: list[UndeterminedDirection] = []

    @property
    def names(self) -> list[str]:
        return [f"{self._joined.members[i].name}.{n}" for i, r, _ in self._own for n in r.names]

    @property
    def counts(self) -> list[int]:
        """Values per column."""
        return [r.model.step.k for _, r, own in self._own for _ in own]

    def of(self, member: int) -> Ints:
        """Columns of the unknowns of a member."""
        return next((own for i, _, own in self._own if i == member), np.zeros(0, int))

    def values(self) -> Array:
        """The unknowns at the last instant that is known."""
        return np.concatenate([np.zeros(0), *(r.unknown for _, r, _ in self._own)])

    @cached_property
    def row_nominal(self) -> Array:
        """The size that a row is measured by where all of its terms are zero."""
        sizes = [np.abs(r.B).max(axis=1, initial=0) for _, r, _ in self._own]
        return np.maximum(np.concatenate([np.zeros(0), *sizes]), 1e-3)

    def added(self, plain: csr_array) -> csr_array:
        """The rows of junctions and signals with those of the relations in their present modes."""
        if not self._own:
            return plain
        parts = [plain.tocoo()]
        entries = [(parts[0].coords[0], parts[0].coords[1], parts[0].data)]
        for i, r, own in self._own:
            columns, P = self._joined.reach(i)
            for rows, cols, M in ((own, columns, r.B @ P), (columns, own, (r.B @ P).T), (own, own, r.J)):
                entries.append((np.repeat(rows, len(cols)), np.tile(cols, len(rows)), M.ravel()))
        for found in self.undetermined:
            cols = np.flatnonzero(found.row)
            entries.append((np.full(len(cols), found.at), cols, -found.row[cols]))
        row, column, value = (np.concatenate([e[j] for e in entries]) for j in range(3))
        total = csr_array(coo_array((value, (row, column)), shape=(self._n, self._n)))
        total.eliminate_zeros()
        return total
