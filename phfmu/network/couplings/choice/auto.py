"""Choice of the coupling that fits a network, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from phfmu.network.couplings.coupling_table import GAUSS_SEIDEL, MONOLITHIC, NEWTON, CouplingRow
from phfmu.network.network import Network


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
