"""Junction unknowns at the start of a run, which no step has ended at: those of the instant, as composed models have them.

Where the outputs of members follow them they solve the rows of the instant.  Voltages of nodes where only states meet, and
multipliers of rigid joints, do not: they are what keeps the sums zero a moment later.  They are the limit, for h -> 0, of steps,

    xi(0) = lim p_h(t0),      p_h: the polynomial through the node values of a step of length h,

extrapolated from steps h, h/2, ... by Neville's scheme.  Other tools' units need steps that they can take back, and no more.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from phfmu.gradients.quadrature import nodes
from phfmu.network.couplings.coupling import Solution
from phfmu.network.couplings.node_newton import NodeSolution
from phfmu.network.interface.end_sums import EndSums
from phfmu.network.interface.exchange import Exchange
from phfmu.network.interface.instant import Instant
from phfmu.network.interface.joined import Joined
from phfmu.outcome.status import StepFailure

Array = NDArray[np.float64]

MOST = 10  # steps, each half of the one before
FOUND = 1e-12  # of the largest unknown of a kind: estimates that differ by less are one
TRUSTED = 1e-6  # and that differ by more are none


def start_values(
    joined: Joined,
    sums: EndSums,
    exchange: Exchange | None,
    xi: Array,
    tried: Callable[[float], Solution],
    t: float,
    h: float,
) -> Array | None:
    """xi at the start; None where it cannot be found.  `tried`: takes a step of some length and takes it back."""
    sums.values(xi)
    if not sums.hide:
        return at_instant(joined, xi, t)
    if joined.put_off:
        return None
    return limit(tried, exchange, joined.face.nominal, h)


def at_instant(joined: Joined, xi: Array, t: float) -> Array | None:
    """xi where outputs follow it; None where that cannot be solved."""
    try:
        return Instant().solve(joined, xi, t)
    except (StepFailure, ValueError):
        return None


def limit(step: Callable[[float], Solution], exchange: Exchange | None, nominal: Array, h: float) -> Array | None:
    """xi from `step`, which takes a step of some length from the start and takes it back; None where steps tend to nothing."""
    row: list[Array] = []
    best, found = np.inf, None
    for j in range(MOST):
        try:
            new = [_begin(step(h / 2**j), exchange)]
        except StepFailure:
            break
        for m, old in enumerate(row):
            new.append(new[-1] + (new[-1] - old) / (2 ** (m + 1) - 1))
        if row:
            moved = float(np.max(np.abs(new[-1] - row[-1]) / np.maximum(np.abs(new[-1]), nominal), initial=0.0))
            if moved < best:
                best, found = moved, new[-1]
            elif best <= TRUSTED:  # rounding from here on
                break
            if best <= FOUND:
                break
        row = new
    return found if best <= TRUSTED else None


def _begin(solution: Solution, exchange: Exchange | None) -> Array:
    """The polynomials at the start of the step; impulses belong to its ends and tend to nothing."""
    if exchange is None or not isinstance(solution, NodeSolution) or solution.found is None:
        return solution.xi
    xi = solution.found.xi
    return np.array([nodes(int(k)).value(0.0) @ xi[exchange.columns == c] for c, k in enumerate(exchange.k)])
