"""Jacobi coupling: all members step at once, with each other's outputs at the start of the step (`runtime/in_turn.c`)."""

from __future__ import annotations

from phfmu.network.interface.coupled_members import CoupledMembers


class Jacobi:
    """Every member once, under values of time t.  Cheap and in parallel, but it makes energy: the step must be small."""

    order, repeats, closes = 1, False, False

    def groups(self, joined: CoupledMembers) -> list[list[int]]:
        """All step at once."""
        return [[*range(len(joined.members))]]
