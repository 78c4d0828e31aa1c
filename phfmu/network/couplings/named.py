"""Couplings of members by the names users know."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from phfmu.network.couplings.anderson import Anderson
from phfmu.network.couplings.coupling import Coupling
from phfmu.network.couplings.gauss_seidel import GaussSeidel, complete, usual_sequence
from phfmu.network.couplings.jacobi import Jacobi
from phfmu.network.couplings.joined import Joined
from phfmu.network.couplings.newton import Newton
from phfmu.network.couplings.node_newton import newton
from phfmu.network.couplings.unconverged import POLICIES
from phfmu.network.junctions.network import Network

#: couplings that repeat steps
ITERATED: dict[str, Callable[[Joined], Coupling]] = {Newton.name: newton, Anderson.name: lambda _: Anderson()}


@dataclass(frozen=True)
class Named:
    """A coupling that was asked for.

    words:  for the head line of a run
    order:  the most that it keeps where members exchange one value; `held`: why
    nodes:  whether it exchanges the values at the nodes of steps where members take them
    """

    words: str
    order: int
    held: str
    nodes: bool
    make: Callable[[Joined], Coupling]


def named_coupling(
    name: str, network: Network, sequence: Sequence[str] | None = None, unconverged: str = "raise"
) -> Named:
    """The coupling `name` of members of a network.

    sequence:  of the members, for gauss-seidel;  unconverged:  raise | halve | accept, for couplings that iterate
    Errors: ValueError for what does not go together.
    """
    if sequence is not None and name != GaussSeidel.name:
        raise ValueError(f"a sequence of members ({', '.join(sequence)}) is for {GaussSeidel.name}, not for {name}")
    if name in ITERATED:
        wrap, make = POLICIES[unconverged], ITERATED[name]
        at_nodes = name == Newton.name
        return Named(f"{name} coupling", Newton.order, "inputs held", at_nodes, lambda joined: wrap(make(joined)))
    if unconverged != "raise":
        raise ValueError(f"--unconverged {unconverged} is for couplings that iterate; {name} takes each step once")
    lagged = "outputs of an instant held"
    if name == Jacobi.name:
        return Named(f"{name} coupling", Jacobi.order, lagged, False, lambda _: Jacobi())
    if name == GaussSeidel.name:
        order = usual_sequence(network) if sequence is None else complete(sequence, network)
        words = f"{name} coupling ({', '.join(order)})"
        return Named(words, GaussSeidel.order, lagged, False, lambda _: GaussSeidel(order))
    raise ValueError(f"no coupling '{name}' of members")
