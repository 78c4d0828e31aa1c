"""Gauss-Seidel coupling: members step one after the other, each with the newest outputs of the others (`runtime/in_turn.c`).

Before a member steps, the junction unknowns are those that the present outputs give (`interface/instant.py`).  They are held
over the step.  What the junctions take, sum h U^T Y, is booked by the members.
"""

from __future__ import annotations

from collections.abc import Sequence

from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.network import Network
from phfmu.words import meant


class GaussSeidel:
    """Every member once, in turn.  `sequence`: names of members, by default `usual_sequence`."""

    order, repeats, closes = 1, False, False

    def __init__(self, sequence: Sequence[str] | None = None) -> None:
        self._sequence = sequence

    @staticmethod
    def sequence_of(network: Network, sequence: Sequence[str] | None) -> tuple[str, ...]:
        """The sequence that was asked for, or the usual one; raises ValueError if it is not one of the members."""
        return usual_sequence(network) if sequence is None else complete(sequence, network)

    def groups(self, joined: CoupledMembers) -> list[list[int]]:
        """Places of members among all, in the order in which they step; raises ValueError if the sequence is not theirs."""
        at = {m.name: i for i, m in enumerate(joined.members)}
        return [[at[name]] for name in self.sequence_of(joined.network, self._sequence)]


def usual_sequence(network: Network) -> tuple[str, ...]:
    """Members that are given efforts come first, as they take the newest flows to those that are given flows."""
    given: dict[str, list[bool]] = {name: [] for name in network.members}
    for j in network.junctions:
        for end in j.ends:
            given[end.member].append(network.port_of(end).given == "flow")
    return tuple(sorted(given, key=lambda name: sum(given[name]) / max(len(given[name]), 1)))


def complete(sequence: Sequence[str], network: Network) -> tuple[str, ...]:
    """The sequence, if it has each member of the network once; raises ValueError else."""
    for name in sequence:
        if name not in network.members:
            raise ValueError(f"{network.name} has no member '{name}'; {meant(name, network.members)}")
    missing = [n for n in network.members if n not in sequence]
    if missing or len(sequence) != len(network.members):
        what = f"it lacks {', '.join(missing)}" if missing else "a member is named twice"
        raise ValueError(f"sequence {', '.join(sequence)}: each member of {network.name} comes once, {what}")
    return tuple(sequence)
