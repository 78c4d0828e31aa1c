"""Which coupling fits a network, and why."""

from __future__ import annotations

from dataclasses import dataclass

from phfmu.network.junctions.network import Network


@dataclass(frozen=True)
class Choice:
    """A coupling by its name, and the sentence that says why."""

    name: str
    why: str


def choose(network: Network, fmus: bool = False) -> Choice:
    """One model where all members are declared; else steps are repeated, where all units can go back, or taken once.

    `fmus`: some declared members are to be stepped as exported units.
    """
    units = network.units
    if not units and not fmus:
        return Choice("monolithic", "all members are declared, so they are stepped as one model")
    stuck = [name for name, unit in units.items() if not unit.interface.saves]
    if stuck:
        whose = "their" if len(stuck) > 1 else "its"
        return Choice(
            "gauss-seidel",
            f"{', '.join(stuck)} cannot save {whose} state, so no step can be repeated; junctions make energy, which is told",
        )
    named = ", ".join(units) or "some members"
    return Choice("newton", f"{named} cannot be composed, and all members can repeat a step")
