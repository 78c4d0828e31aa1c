"""The modes of a declaration with switches: the same variables, a structure each.

A switch that is on puts its column into J; off, its multiplier has the row 0 = -mu, which takes no power and is listed with J.
So the search for hidden rows sees what is there in a mode and nothing else, and all modes have the same states, algebraic
variables, ports and parameters.

Directions of the algebraic variables that no row determines in a mode (the potential of a part of a circuit that nothing conducts
to, currents around a ring of closed switches) get the rows that make them least in norm; they move nothing and take no power.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.block import Block, block, skew
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import Variable, _sx
from phfmu.events.switch_system import SwitchSystem, UndeterminedDirection

Mode = tuple[int, ...]
Array = NDArray[np.float64]

#: fraction of a typical multiplier that counts as zero
ZERO = 1e-6


class Modes:
    """The declaration of every mode, made when it is first asked for."""

    def __init__(self, declaration: PHDAE):
        self.declaration, self.switches = declaration, declaration.switches
        self._known: dict[Mode, PHDAE] = {}

    @cached_property
    def whole(self) -> PHDAE:
        """The declaration with the modes as symbols in J, without the rows of multipliers that are off."""
        on = (skew(v, s.multiplier, _sx(c) * s.mode.sx, owner=s.owner) for s in self.switches for v, c in s.on.items())
        return self._plain((*self.declaration.structure, *on))

    @cached_property
    def system(self) -> SwitchSystem:
        """The switch system: the equations of the model with the modes as numbers."""
        off = (block([s.multiplier], -(1 - s.mode.sx) * s.scale) for s in self.switches)
        return SwitchSystem(self.declaration, replace(self.whole, structure=(*self.whole.structure, *off)))

    @cached_property
    def names(self) -> list[str]:
        """Names of the scalar parameters."""
        return [n for v in self.declaration.parameters for n in v.names()]

    @property
    def start(self) -> Mode:
        """The modes that the parameters start with."""
        return tuple(int(round(s.mode.start[0])) for s in self.switches)

    def declared(self, mode: Mode) -> PHDAE:
        """The declaration in one mode, without switches; its state events are those of all modes."""
        if mode not in self._known:
            self._known[mode] = self._made(mode)
        return self._known[mode]

    def _made(self, mode: Mode) -> PHDAE:
        structure = list[Block]()
        for s, on in zip(self.switches, mode, strict=True):
            if on:
                structure += [skew(v, s.multiplier, column, owner=s.owner) for v, column in s.on.items()]
            else:
                structure.append(block([s.multiplier], -s.scale))
        structure += [_least(self.declaration.algebraics, found) for found in self.system.undetermined(mode)]
        return self._plain((*self.declaration.structure, *structure))

    def _plain(self, structure: tuple[Block, ...]) -> PHDAE:
        d = self.declaration
        events = tuple(e for s in self.switches for e in s.events(d.effort))
        return replace(d, structure=structure, state_events=(*d.state_events, *events), switches=())


def _least(variables: Sequence[Variable], found: UndeterminedDirection) -> Block:
    """A row that makes the algebraic variables zero along a direction.

    In one row only: the search for hidden rows must see the others as they are.
    """
    taken = [(v.part(i, 1) if v.size is not None else v) for v in variables for i in range(v.n)]
    inside = np.flatnonzero(found.row)
    matrix = ca.SX(len(inside), len(inside))
    matrix[int(np.searchsorted(inside, found.at)), :] = -ca.DM(found.row[inside]).T
    return block([taken[i] for i in inside], matrix)


def most_held(modes: Modes, present: Mode, a: Array, j: int) -> float:
    """The largest value that switch j, which falls to zero in a mode, could hold if others on which it depends held less."""
    system, switches = modes.system, modes.switches
    if not (found := system.undetermined(present)):
        return 0.0
    D = np.array([u.row for u in found]).T * system.nominal[:, None] ** 2
    D /= np.abs(D / system.nominal[:, None]).max(axis=0)
    mine = system.multipliers[j]
    if np.abs(a[mine]) > ZERO * system.nominal[mine] or not np.abs(D[mine]).max() > ZERO * system.nominal[mine]:
        return 0.0
    at = np.array([system.multipliers[i] for i, s in enumerate(switches) if present[i] and s.unilateral])
    size = system.nominal[at]
    most = _most(D[mine] / system.nominal[mine], D[at] / size[:, None], np.maximum(a[at] / size, 0.0))
    return most * float(system.nominal[mine]) if most > ZERO else 0.0


def _most(d: Array, D: Array, mu: Array) -> float:
    """max d t with mu + D t >= 0; 0 if it has no bound (a current that circulates and does nothing)."""
    from scipy.optimize import linprog

    found = linprog(-d, A_ub=-D, b_ub=mu, bounds=(None, None))
    return -float(found.fun) if found.status == 0 else 0.0
