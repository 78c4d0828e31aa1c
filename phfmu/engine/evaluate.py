"""Evaluation of a plan in Python: kernels in CasADi's virtual machine on preallocated buffers, tables in numpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.plan.plan import Group, Plan, Products

Array = NDArray[Any]


class Buffered:
    """A kernel function mapped over the instances of a group, with its arguments and results as numpy arrays."""

    def __init__(self, function: Any, n: int, widths_in: list[int], widths_out: list[int]):
        mapped = function.map(n) if n > 1 else function
        self.arg: list[Any] = [np.zeros((n, w)) for w in widths_in]
        self.res: list[Any] = [np.zeros((n, w)) for w in widths_out]
        self._keep = mapped.buffer()
        buffer, self.call = self._keep
        for i, a in enumerate(self.arg):
            if a.size:
                buffer.set_arg(i, memoryview(a))
        for i, r in enumerate(self.res):
            if r.size:
                buffer.set_res(i, memoryview(r))


@dataclass
class _GroupWork:
    group: Group
    values: Buffered
    ledger: Buffered | None

    def gather(self, target: Buffered, x: Array, y: Array, p: Array) -> None:
        g = self.group
        for array, source, index in zip(target.arg, (x, y, p), (g.xi, g.yi, g.pi), strict=True):
            if index.size:
                np.take(source, index, out=array)


class Evaluator:
    """Z, R, V, A and the ledger of one plan at given x, v, p and h.

    `rests`: constraints that are left out, w = 0 in place of their rows;  `gap`: what they miss.
    Arrays belong to the evaluator and are overwritten by the next call.
    """

    def __init__(self, plan: Plan):
        self.plan = plan
        self._work = []
        for g in plan.groups:
            k = g.kernel
            values = Buffered(k.function, g.n, [k.nx, k.ny, k.np], [k.no, k.nj])
            ledger = None if k.ledger is None else Buffered(k.ledger, g.n, [k.nx, k.ny, k.np], [1] * k.ledger.n_out())
            self._work.append(_GroupWork(g, values, ledger))
        self.V = np.zeros(plan.nslot)
        self.V[0] = 1.0
        self.Y = np.zeros(plan.nv + plan.nz)
        self.R = np.zeros(plan.nrow)
        self.rests, self.gap = plan.hold.rests.copy(), np.zeros(len(plan.hold))
        self._entry = {id(p): np.repeat(np.arange(p.nnz), np.diff(p.ptr)) for p in (plan.matrix, plan.derivative)}

    def residual(self, x: Array, v: Array, p: Array, h: float) -> Array:
        """R at (x, v, p, h); fills Y and V on the way."""
        plan, y = self.plan, self.Y
        y[: plan.nv] = v
        y[plan.nv :] = 0.0
        y[plan.hold.of(self.rests)] = 0.0  # exactly, whatever rounding the factor leaves
        for w in self._work:
            if w.group.stage == 0:
                y[plan.nv :] += self._group(w, x, p, h, plan.nz)
        r = np.bincount(plan.const_row, plan.const_val * h**plan.const_pow * y[plan.const_src], plan.nrow).astype(float)
        for w in self._work:
            if w.group.stage == 1:
                r += self._group(w, x, p, h, plan.nrow)
        self._rest(r)
        self.R = r
        return r

    def _group(self, w: _GroupWork, x: Array, p: Array, h: float, size: int) -> Array:
        g = w.group
        w.gather(w.values, x, self.Y, p)
        w.values.call()
        self.V[g.slot : g.slot + g.n * g.kernel.nj] = w.values.res[1].ravel()
        return np.bincount(g.oi.ravel(), (w.values.res[0] * h**g.power).ravel(), size)

    def _rest(self, r: Array) -> None:
        """Rows at rest are 0, after a look at what they miss: the mean of the node rows is (g' - g) / h."""
        plan = self.plan
        for c in np.flatnonzero(self.rests):
            rows = list(plan.hold.rows[c])
            self.gap[c] = max(abs(plan.weights @ r[rows[: plan.k]]), *np.abs(r[rows[plan.k :]]), 0.0)
            r[rows] = 0.0

    def matrix(self, h: float) -> Array:
        """Values of A from the current slots; rows at rest have 1 on the diagonal."""
        lists = self.plan.matrix
        values = self.products(lists, h)
        rests = np.isin(lists.row, self.plan.hold.of(self.rests))
        return np.where(rests, (lists.row == lists.col).astype(float), values)

    def products(self, lists: Products, h: float) -> Array:
        """Values of a sparse matrix from the current slots."""
        terms = lists.value * h**lists.power * self.V[lists.s] * self.V[lists.t]
        return np.bincount(self._entry[id(lists)], terms, lists.nnz)

    def ledger(self, x: Array, p: Array) -> tuple[Array, Array, Array, Array]:
        """Per component: sums of `stored`, |stored|, `lost` and `numerical` at the last residual's Y."""
        n = self.plan.ncomp
        sums, moved = np.zeros((3, n)), np.zeros(n)
        for w in self._work:
            if w.ledger is not None:
                w.gather(w.ledger, x, self.Y, p)
                w.ledger.call()
                for total, values in zip(sums, w.ledger.res, strict=False):
                    total += np.bincount(w.group.owner, values[:, 0], n)
                moved += np.bincount(w.group.owner, np.abs(w.ledger.res[0][:, 0]), n)
        return sums[0], moved, sums[1], sums[2]
