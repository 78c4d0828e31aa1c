"""Coordinates that enter a function through their differences only: springs, dampers and bars between two bodies.

A function of x_a - x_b is worked out in d = x_a - x_b: half the arithmetic, and as exact far from the origin as near it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import casadi as ca
import numpy as np

from phfmu.declare.expressions.operations import ANALYTIC
from phfmu.plan.buffered import BufferedFunction
from phfmu.plan.spec import Spec

#: more coordinates of a kind than this are left as they are
MOST = 24


@dataclass(frozen=True)
class Differences:
    """Coordinates of a local function: pairs (plus, minus) of places of a vector; minus = -1 for a single one."""

    pairs: tuple[tuple[int, int], ...]

    def substitution(self, x: ca.SX, name: str) -> tuple[ca.SX, ca.SX]:
        """The coordinates d as symbols, and x in terms of them: x_plus = d, x_minus = 0."""
        d, values = ca.SX.sym(name, len(self.pairs)), [ca.SX(0)] * x.numel()
        for j, (plus, _) in enumerate(self.pairs):
            values[plus] = d[j]
        return d, ca.vertcat(*values) if values else ca.SX(0, 1)

    def globally(self, index: Sequence[int]) -> tuple[list[int], list[int]]:
        """Global indices of the plus and minus places; -1 where there is no minus."""
        return [index[p] for p, _ in self.pairs], [index[m] if m >= 0 else -1 for _, m in self.pairs]


def differences(f: ca.Function, which: int, places: Sequence[Sequence[int]] | None = None) -> Differences:
    """Places of argument `which` that the function depends on through their difference only, found by sampling.

    `places`: indices that belong together, shifted each by an amount of its own; default: every index by itself.
    What it does not depend on in the end (an inverse that cancels) is no difference.
    """
    rng = np.random.default_rng(1)
    together = [[j] for j in range(f.numel_in(which))] if places is None else places
    points = [[rng.uniform(0.5, 1.5, f.numel_in(i)) for i in range(f.n_in())] for _ in range(2)]
    sample = StackedFunction(f)
    values = [sample(point) for point in points]
    free, pairs = list(range(len(together))), []
    while free:
        a, b = free.pop(0), -1
        if not _invariant(sample, which, points, values, [together[a]]):
            b = next((b for b in free if _invariant(sample, which, points, values, [together[a], together[b]])), -1)
        if b >= 0:
            free.remove(b)
        pairs.append((b, a) if b >= 0 else (a, -1))
    return Differences(tuple(pairs))


class StackedFunction:
    """All results of a function in one array, at points given as a list of arrays."""

    def __init__(self, f: ca.Function):
        ends = np.cumsum([0, *(f.numel_out(i) for i in range(f.n_out()))])
        self._all = np.zeros(ends[-1])
        parts = [self._all[a:b].reshape(1, -1) for a, b in pairwise(ends)]
        self._function = BufferedFunction(f, [np.zeros((1, f.numel_in(i))) for i in range(f.n_in())], parts)

    def __call__(self, point: Sequence[np.ndarray]) -> np.ndarray:
        for place, values in zip(self._function.arg, point, strict=True):
            place[0] = values
        self._function.call()
        return self._all.copy()


def _invariant(sample: StackedFunction, which: int, points: list, values: list, places: list[Sequence[int]]) -> bool:
    for point, value in zip(points, values, strict=True):
        moved = point[which].copy()
        for group in places:
            moved[list(group)] += 0.734 + 0.319 * np.arange(len(group))
        if not (
            np.abs(sample([*point[:which], moved, *point[which + 1 :]]) - value) <= 1e-12 * (1.0 + np.abs(value))
        ).all():
            return False
    return True


def in_differences(spec: Spec) -> Spec:
    """The kernel with all arguments that matter through differences only replaced by these differences."""
    y = ca.vertcat(*(s for _, s in spec.y)) if spec.y else ca.SX(0, 1)
    f = _function(spec, y)
    if not {f.instruction_id(i) for i in range(f.n_instructions())} <= ANALYTIC:
        return spec
    old, new = [], []
    kinds: list[tuple[int, list[list[int]]]] = [(0, [[j] for j in range(spec.x.numel())])]
    for place in dict.fromkeys(a.place for a, _ in spec.y):
        found: dict[int, list[int]] = {}
        for n, (a, _) in enumerate(spec.y):
            if a.place is place:
                found.setdefault(a.j, []).append(n)
        kinds.append((1, list(found.values())))
    for which, places in kinds:
        if len(places) > MOST or len({len(p) for p in places}) > 1:
            continue
        symbols = (spec.x, y)[which]
        for plus, minus in differences(f, which, places).pairs:
            if minus >= 0:
                for a, b in zip(places[plus], places[minus], strict=True):
                    old += [symbols[a], symbols[b]]
                    new += [symbols[a] - symbols[b], ca.SX(0)]
    if not old:
        return spec

    def moved(e: ca.SX | None) -> ca.SX | None:
        return None if e is None else ca.substitute(ca.SX(e), ca.vertcat(*old), ca.vertcat(*new))

    out = [(address, power, moved(e)) for address, power, e in spec.out]
    better = replace(spec, out=out, stored=moved(spec.stored), lost=moved(spec.lost), numerical=moved(spec.numerical))
    return better if _alike(f, _function(better, y)) else spec


def _function(spec: Spec, y: ca.SX) -> ca.Function:
    exprs = [ca.vertcat(*(e for _, _, e in spec.out)), spec.stored, spec.lost, spec.numerical]
    return ca.Function("f", [spec.x, y, spec.p], [ca.densify(ca.SX(e)) for e in exprs if e is not None])


def _alike(f: ca.Function, g: ca.Function) -> bool:
    """Equal, with derivatives, at a point chosen at random: putting zeros for coordinates has divided nothing by zero."""
    rng = np.random.default_rng(2)
    point = [rng.uniform(0.5, 1.5, f.numel_in(i)) for i in range(f.n_in())]
    x = [ca.SX.sym(f"x{i}", p.size) for i, p in enumerate(point)]
    values = []
    for h in (f, g):
        out = ca.vertcat(*h.call(x))
        slope = ca.jtimes(out, ca.vertcat(*x), ca.DM.ones(sum(p.size for p in point)))
        values.append(StackedFunction(ca.Function("h", x, [out, slope]))(point))
    return bool(np.allclose(*values, rtol=1e-9, atol=1e-9))
