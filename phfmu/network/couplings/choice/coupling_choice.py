"""Coupling of members: that of a name users know, or the one that fits a network, and why."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from phfmu.network.couplings.coupling_table import COUPLINGS, GAUSS_SEIDEL, MONOLITHIC, NEWTON, CouplingRow
from phfmu.network.network import Network
from phfmu.words import meant

if TYPE_CHECKING:
    from phfmu.network.couplings.coupling import Coupling
    from phfmu.network.interface.coupled_members import CoupledMembers


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
    # composed networks, which ask for their coupling too, need neither
    from phfmu.network.couplings.coupling import solves_rows
    from phfmu.network.couplings.unconverged import POLICIES

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


@dataclass(frozen=True)
class CouplingChoice:
    """A coupling, and the sentence that says why."""

    row: CouplingRow
    why: str


def choose(network: Network, apart: bool = False, stuck: Mapping[str, str] | None = None) -> CouplingChoice:
    """One model where all members are declared; else steps are repeated, where units can go back, or taken once.

    `apart`: declared members are to be stepped in ways of their own.  `stuck`: units that cannot go back and what is wrong with
    them, default those that say so.  One of them is stepped last against a predicted response; with more, predictions would meet,
    so all members step once where outputs of an instant tell what their junctions need.
    """
    units = network.units
    if not units and not apart:
        return CouplingChoice(MONOLITHIC, "all members are declared, so they are stepped as one model")
    if stuck is None:
        stuck = {name: "cannot save its state" for name, unit in units.items() if not unit.interface.saves}
    if len(stuck) > 1 and _given_by_outputs(network):
        why = "; ".join(f"{name} {words}" for name, words in stuck.items())
        made = "; junctions make energy, which is told" if network.junctions else ""
        return CouplingChoice(GAUSS_SEIDEL, f"{why}, so no step can be repeated{made}")
    if stuck:
        last = f"{', '.join(stuck)} {'are' if len(stuck) > 1 else 'is'} stepped last"
        return CouplingChoice(NEWTON, f"units cannot be composed; {last}, other members can repeat a step")
    why = f"{', '.join(units)} cannot be composed" if units else "members have engines or steps of their own"
    return CouplingChoice(NEWTON, f"{why}, and all members can repeat a step")


def _given_by_outputs(network: Network) -> bool:
    """Whether at each junction one output gives the common variable, and the other ports take it."""
    for j in network.junctions:
        if sum(network.port_of(e).given != j.shared for e in j.ends) != 1:
            return False
    return True
