"""Couplings that users can ask for, a row each; imports nothing of the package, so that the command line stays fast.

A new one is a file and a row: the command line with its help, the choice by name and the table of the documentation read it.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

_C = "phfmu.network.couplings."


@dataclass(frozen=True)
class CouplingRow:
    """A coupling by the name that users know.

    name, about:  what they type, and what it is
    order, needs: in words, what the run keeps of the order of its members, and what it asks of them
    where:        its class, imported when asked for; it tells order, repeats and closes (`coupling.Coupling`)
    held:         why members that exchange one value a step keep no more than its order
    at_nodes:     what makes it of `CoupledMembers` that exchange the values at the nodes of steps, if it can
    in_turn:      whether members step one after the other: its class has `sequence_of` and takes the sequence
    apart:        False for what steps one composed model
    """

    name: str
    about: str
    order: str = ""
    needs: str = ""
    where: str = ""
    held: str = ""
    at_nodes: str = ""
    in_turn: bool = False
    apart: bool = True

    @property
    def kind(self) -> Any:
        """Its class."""
        return _found(self.where)

    @property
    def node_maker(self) -> Any:
        """The function `at_nodes`."""
        return _found(self.at_nodes)


def _found(where: str) -> Any:
    module, _, name = where.rpartition(".")
    return getattr(import_module(module), name)


AUTO = CouplingRow("auto", "the one that fits the members", "that of the one taken", "nothing", apart=False)
MONOLITHIC = CouplingRow(
    "monolithic",
    "one composed model",
    "all",
    "all members are declared",
    _C + "monolithic.Monolithic",
    apart=False,
)
NEWTON = CouplingRow(
    "newton",
    "members stepped apart, steps repeated until the junctions hold: exact at any step size",
    "all with k values a step, 2 where one is held",
    "members take steps back, but one",
    _C + "newton.Newton",
    "inputs held",
    _C + "newton.newton",
)
ANDERSON = CouplingRow(
    "anderson",
    "as newton with one value per step, without the members' sensitivities",
    "2",
    "members take steps back, but one",
    _C + "anderson.Anderson",
    "inputs held",
)
GAUSS_SEIDEL = CouplingRow(
    "gauss-seidel",
    "each member steps once, one after the other, with the newest outputs of the others",
    "1",
    "an output gives each junction its value",
    _C + "gauss_seidel.GaussSeidel",
    "outputs of an instant held",
    in_turn=True,
)
JACOBI = CouplingRow(
    "jacobi",
    "each member steps once, all with the outputs at the start of the step (signals: on the line through two samples)",
    "1",
    "an output gives each junction its value",
    _C + "jacobi.Jacobi",
    "outputs of an instant held",
)

COUPLINGS = {row.name: row for row in (AUTO, MONOLITHIC, NEWTON, ANDERSON, GAUSS_SEIDEL, JACOBI)}
