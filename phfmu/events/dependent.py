"""Contacts and diodes that depend on each other: whether one that opens by its share of least norm has to.

Their multipliers are mu + D t, D the directions that no row determines; mu is least in norm.  Where it falls to zero in one
switch, the mode without it is right only if no t keeps all mu + D t >= 0 with that one above zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phfmu.events.modes import Mode, Modes

Array = NDArray[np.float64]

#: of a typical multiplier: what counts as zero
ZERO = 1e-6


@dataclass(frozen=True)
class Shared:
    """A switch that opens though its multiplier could be `most`."""

    switch: int
    most: float


def could_hold(modes: Modes, present: Mode, proposal: Mode, a: Array) -> Shared | None:
    """The first unilateral switch that the proposal opens, of the multipliers in `a` (na), and that others could relieve."""
    opens = [j for j, s in enumerate(modes.switches) if present[j] and not proposal[j] and s.unilateral]
    for j in opens:
        most = most_held(modes, present, a, j)
        if most > 0.0:
            return Shared(j, most)
    return None


def most_held(modes: Modes, present: Mode, a: Array, j: int) -> float:
    """How much switch j, which falls to zero in a mode, could hold if others on which it depends held less; 0: nothing."""
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
