"""Groups of the Schur stepper: the instances of each lane kernel, in the order of the tiles of a sweep.

A sweep has several loops over all degrees of freedom.  It takes them tile by tile: a stretch of degrees of freedom goes
through all of them while it is in the cache.  Instances are sorted by their last degree of freedom; those that reach into
the next tile wait for it, and what they act on is finished with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from phfmu.plan.plan import Ints
from phfmu.schur.lanes import LaneKernel

#: degrees of freedom of a tile: its arrays fill about half of a first-level cache
TILE = 96

#: PH_LANE_* of schur.h, the order of evaluation
KINDS = ("constraint", "strain", "force", "start", "mass", "load")

#: degrees of freedom of coordinates: (plus, minus) of each, -1 for nothing
Ends = tuple[list[int], list[int]]


@dataclass(frozen=True)
class LaneGroup:
    """All instances of one lane kernel; tables are instance-major, `stress`: kernel of a strain's stresses.

    `until`, `settled` (ntile + 1): instances evaluated with, and rows complete after, each tile.
    `first`: first row (constraint, strain) of the group;  `point`: first of its coordinates;  zp, zm: degrees of freedom
    of rates, op, om: of results, m subtracted (index ndof: nothing);  ui: inputs;  pi: parameters.
    """

    kernel: LaneKernel
    stress: LaneKernel | None
    n: int
    first: int
    point: int
    zp: Ints
    zm: Ints
    ui: Ints
    pi: Ints
    op: Ints
    om: Ints
    until: Ints = field(default_factory=lambda: np.zeros(1, np.int32))
    settled: Ints = field(default_factory=lambda: np.zeros(1, np.int32))


def in_order(groups: Sequence[LaneGroup]) -> list[LaneGroup]:
    """The groups as the tables list them."""
    return sorted(groups, key=lambda g: KINDS.index(g.kernel.kind))


@dataclass
class Instances:
    """Instances of terms that share their kernels; x, z, o: degrees of freedom (plus, minus) of their coordinates."""

    kernels: tuple[LaneKernel, ...]
    x: list[Ends] = field(default_factory=list)
    z: list[Ends] = field(default_factory=list)
    o: list[Ends] = field(default_factory=list)
    u: list[list[int]] = field(default_factory=list)
    p: list[list[int]] = field(default_factory=list)
    multiplier: list[int] = field(default_factory=list)

    def add(self, x: Ends, z: Ends, o: Ends, u: list[int], p: list[int], multiplier: int) -> None:
        self.x.append(x)
        self.z.append(z)
        self.o.append(o)
        self.u.append(u)
        self.p.append(p)
        self.multiplier.append(multiplier)

    def sort(self) -> None:
        """Sort the instances by their last degree of freedom."""
        order = np.argsort(self.reach(max, -1), kind="stable")
        for name in ("x", "z", "o", "u", "p", "multiplier"):
            values = getattr(self, name)
            setattr(self, name, [values[i] for i in order])

    def reach(self, of: Callable[[list[int]], int], nothing: int) -> np.ndarray:
        """First or last degree of freedom of every instance."""
        found = (
            [d for ends in each for side in ends for d in side if d >= 0]
            for each in zip(self.x, self.z, self.o, strict=True)
        )
        return np.array([of(dofs) if dofs else nothing for dofs in found], np.int64)

    def groups(self, first: int, point: int, ndof: int) -> list[LaneGroup]:
        n = len(self.x)

        def table(values: list) -> Ints:
            array = np.array(values, np.int32).reshape(n, -1)
            return np.where(array < 0, np.int32(ndof), array)

        ends = [table([v[i] for v in values]) for values in (self.z, self.o) for i in (0, 1)]
        inputs = [table(self.u), table(self.p)]
        stress = next((k for k in self.kernels if k.kind in ("stress", "pointwise")), None)
        kernels = [k for k in self.kernels if k is not stress]
        return [
            LaneGroup(k, stress if k.kind == "strain" else None, n, first, point, *ends[:2], *inputs, *ends[2:])
            for k in kernels
        ]


@dataclass(frozen=True)
class Tiles:
    """Degrees of freedom that begin with each tile, have complete forces and complete rows after it; loads that begin."""

    dof: Ints
    done: Ints
    final: Ints
    load: Ints


def tiled(
    groups: Sequence[LaneGroup], kinds: Sequence[Instances], ndof: int, load_dof: Ints
) -> tuple[tuple[LaneGroup, ...], Tiles]:
    """The groups with their parts of the tiles; `kinds`: the (sorted) instances of each group."""
    dof = np.append(np.arange(0, ndof, TILE), ndof) if ndof else np.zeros(1, np.int64)
    last = [k.reach(max, -1) for k in kinds]
    left = [np.append(np.minimum.accumulate(k.reach(min, ndof)[::-1])[::-1], ndof) for k in kinds]
    until = [np.searchsorted(ends, dof) for ends in last]
    done = np.minimum.reduce([dof, *(first[n] for first, n in zip(left, until, strict=True))])
    settled = [np.searchsorted(ends, done) for ends in last]
    rows = [i for i, g in enumerate(groups) if g.kernel.kind == "constraint"]
    final = np.minimum.reduce([done, *(left[i][settled[i]] for i in rows)])
    tiles = Tiles(*(v.astype(np.int32) for v in (dof, done, final, np.searchsorted(load_dof, dof))))
    parts = [
        replace(g, until=u.astype(np.int32), settled=s.astype(np.int32))
        for g, u, s in zip(groups, until, settled, strict=True)
    ]
    return tuple(parts), tiles
