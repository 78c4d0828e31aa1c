"""Connected buses of a grid, and the angles that its voltages begin with: one linear (DC) power flow."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from phfmu.importers.grid import Grid, Line, Transformer

Branches = Iterable[Line | Transformer]


def apart(grid: Grid, buses: Iterable[int], branches: Branches) -> list[int]:
    """The buses that no branch in service joins to the slack bus."""
    place = {n: k for k, n in enumerate(buses)}
    ends = np.array([(place[b.i], place[b.j]) for b in branches]).reshape(-1, 2)
    graph = sp.coo_matrix((np.ones(len(ends)), ends.T), shape=(len(place), len(place)))
    labels = connected_components(graph, directed=False)[1]
    return [n for n, k in place.items() if labels[k] != labels[place[grid.slack.number]]]


def angles(grid: Grid, buses: Iterable[int], branches: Branches) -> dict[int, float]:
    """Angles [rad] of the voltages by bus: P = B theta with the reactances of the branches alone.

    The losses, which are what the powers leave over, are taken in proportion to the loads.
    Newton's method for the operating point begins with these, since flat angles lead it astray in large grids.
    """
    place = {n: k for k, n in enumerate(buses)}
    power, demand = np.zeros(len(place)), np.zeros(len(place))
    for g in grid.generators:
        if g.on and g.bus in place:
            power[place[g.bus]] += g.p
    for d in grid.demands:
        if d.on and d.bus in place:
            demand[place[d.bus]] += max(d.p + d.ip + d.yp, 0.0)
            power[place[d.bus]] -= d.p + d.ip + d.yp
    for s in grid.shunts:
        if s.on and s.bus in place:
            power[place[s.bus]] -= s.g
    if demand.any():
        power -= power.sum() * demand / demand.sum()
    power /= grid.base
    rows: list[tuple[int, int, float]] = []
    for b in branches:
        i, j = place[b.i], place[b.j]
        tap, shift = (b.tap, b.shift) if isinstance(b, Transformer) else (1.0, 0.0)
        y = 1.0 / (b.x * tap)
        rows += [(i, i, y), (j, j, y), (i, j, -y), (j, i, -y)]
        power[i] += y * shift
        power[j] -= y * shift
    i, j, y = zip(*rows, strict=True) if rows else ((), (), ())
    B = sp.csr_matrix((y, (i, j)), shape=(len(place), len(place)))
    kept = np.array([k for n, k in place.items() if n != grid.slack.number], int)
    theta = np.zeros(len(place))
    if len(kept):
        theta[kept] = np.asarray(spsolve(B[kept][:, kept].tocsc(), power[kept]))
    return {n: float(theta[k] + grid.slack.va) for n, k in place.items()}
