"""Grids of any size, made: a lattice of lines with a load at each bus and machines behind transformers."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, sqrt

import numpy as np

from phfmu.components.grids.angles import angles
from phfmu.importers.grid import Bus, Demand, Dynamics, Generator, Grid, Line, Transformer

#: buses of the lattice for one machine; its data on its own base
EACH = 8
MACHINE = {
    "Td10": 6.0, "Td20": 0.05, "Tq10": 1.0, "Tq20": 0.05, "H": 4.0, "D": 0.0, "xd": 1.4, "xq": 1.35, "xd1": 0.3, "xq1": 0.6,
    "xd2": 0.2, "xl": 0.1, "S1": 0.0, "S12": 0.0, "ra": 0.003,
}  # fmt: skip


def lattice(n: int, seed: int = 0) -> Grid:
    """A grid of n buses (at least 9): about n/9 machines of 20 kV, the others of 230 kV on a lattice, the same for each seed.

    Line lengths and loads vary by chance; each machine feeds the loads around it and its share of the losses.
    ValueError for fewer buses.
    """
    if n < EACH + 1:
        raise ValueError(f"lattice({n}): it has at least {EACH + 1} buses")
    rng = np.random.default_rng(seed)
    machines = n // (EACH + 1)
    inner = n - machines
    width = ceil(sqrt(inner))
    lines = []
    for k in range(inner):
        for other in (k + 1 if (k + 1) % width else inner, k + width):
            if other < inner:
                length = float(rng.uniform(0.5, 1.5))
                lines.append(Line(k + 1, other + 1, "1", 0.004 * length, 0.04 * length, 0.08 * length))
    loads = rng.uniform(0.4, 1.0, inner) * 100.0
    demands = tuple(Demand(k + 1, "1", float(p), float(0.3 * p)) for k, p in enumerate(loads))
    fed = np.array_split(np.arange(inner), machines)
    buses = [Bus(k + 1, f"bus {k + 1}", 230.0, 1, 1.0, 0.0) for k in range(inner)]
    transformers, generators, dynamics = [], [], []
    for m, around in enumerate(fed):
        number, p = inner + m + 1, float(loads[around].sum())
        base = 1.3 * p
        buses.append(Bus(number, f"machine {m + 1}", 20.0, 3 if m == 0 else 2, 1.03, 0.0))
        transformers.append(Transformer(number, int(around[len(around) // 2]) + 1, "1", 0.0, 0.1 * 100.0 / base))
        generators.append(Generator(number, "1", p, 0.0, 1.03, number, base))
        dynamics.append(Dynamics(number, "1", "GENROU", MACHINE, "lattice"))
    made = Grid(f"grid{n}", 100.0, 60.0, tuple(buses), tuple(lines), tuple(transformers), demands, (),
                tuple(generators), tuple(dynamics))  # fmt: skip
    theta = angles(made, range(1, n + 1), [*lines, *transformers])
    losses = made.base * sum(b.r * ((theta[b.i] - theta[b.j]) / b.x) ** 2 for b in lines)
    more = 1.0 + losses / loads.sum()
    return replace(made, generators=tuple(replace(g, p=g.p * more) for g in generators))
