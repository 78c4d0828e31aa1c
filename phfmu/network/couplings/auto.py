"""Which coupling fits a network, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from phfmu.network.junctions.network import Network


@dataclass(frozen=True)
class Choice:
    """A coupling by its name, and the sentence that says why."""

    name: str
    why: str


def choose(network: Network, fmus: bool = False, stuck: Mapping[str, str] | None = None) -> Choice:
    """One model where all members are declared; else steps are repeated, where units can go back, or taken once.

    `fmus`: some declared members are to be stepped as exported units.  `stuck`: units that cannot go back and what is wrong with
    them, default those that say so.  One of them is stepped last against a predicted response; of more, predictions would meet.
    """
    units = network.units
    if not units and not fmus:
        return Choice("monolithic", "all members are declared, so they are stepped as one model")
    if stuck is None:
        stuck = {name: "cannot save its state" for name, unit in units.items() if not unit.interface.saves}
    if len(stuck) > 1:
        why = "; ".join(f"{name} {words}" for name, words in stuck.items())
        return Choice("gauss-seidel", f"{why}, so no step can be repeated; junctions make energy, which is told")
    if stuck:
        return Choice("newton", f"all members but {', '.join(stuck)} can repeat a step")
    named = ", ".join(units) or "some members"
    return Choice("newton", f"{named} cannot be composed, and all members can repeat a step")
