"""Couplings of members by the names users know."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from phfmu.network.couplings.coupling import Coupling, solves_rows
from phfmu.network.couplings.coupling_table import COUPLINGS
from phfmu.network.couplings.unconverged import POLICIES
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.network import Network
from phfmu.words import meant


@dataclass(frozen=True)
class NamedCoupling:
    """A coupling that was asked for.

    words:  for the head line of a run
    order:  the most that it keeps where members exchange one value; `held`: why
    nodes:  whether it exchanges the values at the nodes of steps where members take them
    """

    words: str
    order: int
    held: str
    nodes: bool
    make: Callable[[CoupledMembers], Coupling]


def named_coupling(
    name: str, network: Network, sequence: Sequence[str] | None = None, unconverged: str = "raise"
) -> NamedCoupling:
    """The coupling `name` of members of a network.

    sequence:  of the members, for those that step in turn;  unconverged:  raise | halve | accept, for couplings that iterate
    Errors: ValueError for what does not go together.
    """
    rows = {row.name: row for row in COUPLINGS.values() if row.apart}
    if name not in rows:
        raise ValueError(f"no coupling '{name}' of members; {meant(name, rows)}")
    row, in_turn = rows[name], [other.name for other in rows.values() if other.in_turn]
    if sequence is not None and not row.in_turn:
        raise ValueError(f"a sequence of members ({', '.join(sequence)}) is for {', '.join(in_turn)}, not for {name}")
    kind, words = row.kind, f"{name} coupling"
    if unconverged != "raise" and not solves_rows(kind):
        raise ValueError(f"--unconverged {unconverged} is for couplings that iterate; {name} does not iterate")
    make = row.node_maker if row.at_nodes else lambda _: kind()
    if row.in_turn:
        order = kind.sequence_of(network, sequence)
        in_words = ", ".join(member or "the composed member" for member in order)
        words, make = f"{words} ({in_words})", lambda _: kind(order)
    wrap = POLICIES[unconverged]
    return NamedCoupling(words, kind.order, row.held, bool(row.at_nodes), lambda joined: wrap(make(joined)))


def repeats(name: str | None) -> bool:
    """Whether the coupling, or the one that will be chosen, may ask members to take steps back."""
    row = COUPLINGS.get(name or "")
    return row is None or not row.apart or row.kind.repeats
