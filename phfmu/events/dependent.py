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
    system, switches = modes.system, modes.switches
    opens = [j for j, s in enumerate(switches) if present[j] and not proposal[j] and s.law == "unilateral"]
    if not opens or not (found := system.undetermined(present)):
        return None
    D = np.array([u.row for u in found]).T * system.nominal[:, None] ** 2
    D /= np.abs(D / system.nominal[:, None]).max(axis=0)
    on = [j for j, s in enumerate(switches) if present[j] and s.law == "unilateral"]
    at = np.array([system.multipliers[j] for j in on])
    size = system.nominal[at]
    for j in opens:
        mine = system.multipliers[j]
        if np.abs(a[mine]) > ZERO * system.nominal[mine] or not np.abs(D[mine]).max() > ZERO * system.nominal[mine]:
            continue
        most = _most(D[mine] / system.nominal[mine], D[at] / size[:, None], np.maximum(a[at] / size, 0.0))
        if most > ZERO:
            return Shared(j, most * float(system.nominal[mine]))
    return None


def _most(d: Array, D: Array, mu: Array) -> float:
    """max d t with mu + D t >= 0; 0 if it has no bound (a current that circulates and does nothing)."""
    from scipy.optimize import linprog

    found = linprog(-d, A_ub=-D, b_ub=mu, bounds=(None, None))
    return -float(found.fun) if found.status == 0 else 0.0
