"""The mode that follows at an instant: 0 <= c, 0 <= mu, mu c = 0 for all unilateral switches, soon after it.

The equations are taken over a very short backward Euler step, in which rates of c count where c is zero, and impulses where it
cannot stay: its complementarity problem is that of the limit.  Modes are tried by how many switches they change.
Source: Camlibel, Heemels, van der Schaft, Schumacher, IEEE TCAS-I 50 (2003).

Contacts and diodes that depend on each other: whether one that opens by its share of least norm has to.

Their multipliers are mu + D t, D the directions that no row determines; mu is least in norm.  Where it falls to zero in one
switch, the mode without it is right only if no t keeps all mu + D t >= 0 with that one above zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice

import numpy as np
from numpy.typing import NDArray

from phfmu.events.modes import Mode, Modes
from phfmu.events.switch_system import At, Rates, Undetermined

Array = NDArray[np.float64]

#: length of the short step, as a part of the step of the run
SHORT = 1e-6
#: rounding of mu, and of c and rows, as parts of their typical magnitudes
MU, C = 1e-9, 1e-11
#: modes that are tried
MOST_TRIED = 4096


@dataclass(frozen=True)
class Wanted:
    """A change of modes: from `present`, to `proposal` unless the law says otherwise; `fixed`: switches that are not asked."""

    present: Mode
    proposal: Mode
    fixed: frozenset[int]


def select(modes: Modes, at: At, h: float, wanted: Wanted) -> Mode | None:
    """The mode nearest to the proposal that obeys the law; None if no mode that was tried does.  `h`: step of the run."""
    for mode in islice(_candidates(modes, at, wanted), MOST_TRIED):
        if complies(modes, replace(at, p=modes.system.in_mode(at.p, mode)), SHORT * h, mode, wanted):
            return mode
    return None


def _candidates(modes: Modes, at: At, wanted: Wanted) -> Iterator[Mode]:
    asked = [j for j, s in enumerate(modes.switches) if s.unilateral and j not in wanted.fixed]
    values = _values(modes, at.p)
    for many in range(len(asked) + 1):
        for flipped in combinations(asked, many):
            mode = tuple(1 - m if j in flipped else m for j, m in enumerate(wanted.proposal))
            if all(
                m == wanted.present[j] or j in wanted.fixed or may_close(modes, j, m, values)
                for j, m in enumerate(mode)
            ):
                yield mode


def may_close(modes: Modes, j: int, side: int, values: Mapping[str, float]) -> bool:
    """Whether switch j may go to this side by itself."""
    return side == 0 or all(values[n] == v for n, v in modes.switches[j].when.items())


def complies(modes: Modes, at: At, step: float, mode: Mode, wanted: Wanted) -> bool:
    """Whether the switches that are asked obey their law a short step after `at`, in the mode that is in at.p."""
    found = _stepped(modes, at, step, mode)
    if found is None:
        return False
    mu, c, gap = found
    for j, s in enumerate(modes.switches):
        if not s.unilateral or j in wanted.fixed:
            continue
        if mode[j]:
            if mu[j] < -MU * s.multiplier.nominal[0]:
                return False
        elif s.when and not may_close(modes, j, 1, _values(modes, at.p)):
            continue  # blocks in both directions
        elif c[j] < -C * s.nominal and (s.gap is None or gap[j] <= C * s.nominal):
            return False
    return True


def _values(modes: Modes, p: Array) -> dict[str, float]:
    return dict(zip(modes.names, p, strict=True))


def _stepped(modes: Modes, at: At, step: float, mode: Mode) -> tuple[Array, Array, Array] | None:
    """mu, c and gaps after the short step; None if the equations have none or no one solution."""
    system = modes.system
    r: Rates = system.rates(replace(at, t=at.t + step))
    ga, g = r.ga.copy(), r.g.copy()
    for found in system.undetermined(mode):
        ga[found.at] -= found.row
        g[found.at] -= found.row @ at.a
    n1, mass = len(at.x), system.masses(at.p)
    n = n1 + len(at.a)
    matrix = np.empty((n, n))
    matrix[:n1, :n1], matrix[:n1, n1:] = -step * r.fx, -step * r.fa
    matrix[range(n1), range(n1)] += mass
    matrix[n1:, :n1], matrix[n1:, n1:] = -r.gx, -ga
    right = np.concatenate([step * r.f, g])
    rows = np.abs(matrix).max(axis=1, initial=0)
    if not rows.all():
        return None
    matrix, right = matrix / rows[:, None], right / rows
    cols = np.abs(matrix).max(axis=0, initial=0)
    try:
        y = np.linalg.solve(matrix / cols, right) / cols
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(y).all():
        return None
    dx, a = y[:n1], at.a + y[n1:]
    if not _agree(r.ga, system.undetermined(mode), a, system.nominal):
        return None
    return a[system.multipliers], r.c + r.cx @ dx + r.ca @ y[n1:], r.gap


def _agree(ga: Array, free: Sequence[Undetermined], a: Array, nominal: Array) -> bool:
    """Whether the row g in whose place another stands holds for the variables a, to rounding.

    What no row determines is zero then.  Otherwise the rows contradict each other (sources in a ring of closed switches), and
    a variable that the added row makes finite only seems to solve them.
    """
    for d in free:
        size = np.abs(ga[d.at]) @ np.abs(a) + np.abs(d.row) @ (np.abs(a) + nominal)
        if not abs(d.row @ a) <= C * size:
            return False
    return True


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
