"""Evaluation of a plan in Python: kernels in CasADi's virtual machine on preallocated buffers, tables in numpy.

Besides their unknowns the kernels of a step read the state at its start and inputs at its nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.engine.reference.state import State
from phfmu.plan.buffered import BufferedFunction
from phfmu.plan.plan import Group, Plan, Products

Array = NDArray[Any]
TABLES = ("xi", "yi", "pi")  # of a group: where a kernel's arguments x, Y, p are


class Stage:
    """Kernels of several groups: arguments are taken and results summed for all at once, each kernel sees its part.

    `functions`: one per group, with arguments at its places `tables`;  `slots`: V, which takes the second results.
    """

    def __init__(
        self, groups: Sequence[Group], functions: Sequence[Any], tables: Sequence[str], slots: Array | None = None
    ):
        self._index = [_joined([getattr(g, name) for g in groups], int) for name in tables]
        self._taken = [np.zeros(len(index)) for index in self._index]
        self._rows = _joined([g.oi for g in groups], int)
        self._results = np.zeros(len(self._rows))
        self._power = _joined([np.broadcast_to(g.power, g.oi.shape) for g in groups], float)
        self.kernels: list[BufferedFunction] = []
        arrays = [*self._taken, self._results]
        begin = [0] * len(arrays)
        for g, function in zip(groups, functions, strict=True):
            parts = []
            for k, name in enumerate((*tables, "oi")):
                shape = getattr(g, name).shape
                end = begin[k] + shape[0] * shape[1]
                parts.append(arrays[k][begin[k] : end].reshape(shape))
                begin[k] = end
            more = [] if slots is None else [slots[g.slot : g.slot + g.n * g.kernel.nj]]
            self.kernels.append(BufferedFunction(function, parts[:-1], [parts[-1], *more]))

    def take(self, *sources: Array) -> None:
        for taken, index, source in zip(self._taken, self._index, sources, strict=True):
            if len(index):
                source.take(index, out=taken, mode="clip")  # no index is out of bounds: no check, no copy

    def sums(self, h: float, size: int, *sources: Array) -> Array:
        """Per row the sum of the results at `sources`, each times its power of h."""
        if not self.kernels:
            return np.zeros(size)
        self.take(*sources)
        for kernel in self.kernels:
            kernel.call()
        return np.bincount(self._rows, self._results * h**self._power, size)


def _joined(tables: Sequence[Array], kind: type) -> Array:
    return np.concatenate([np.zeros(0, kind), *(t.ravel() for t in tables)])


class Evaluator:
    """Z, R, V, A and the ledger of one plan at given x, v, p and h.

    `rests`: constraints that are left out, w = 0 in place of their rows;  `gap`: what they miss.
    Arrays belong to the evaluator and are overwritten by the next call.
    """

    def __init__(self, plan: Plan):
        self.plan = plan
        self.V = np.zeros(plan.nslot)
        self.V[0] = 1.0
        self.Y = np.zeros(plan.nv + plan.nz)
        self.R = np.zeros(plan.nrow)
        staged = [[g for g in plan.groups if g.stage == stage] for stage in (0, 1)]
        self._stages = [Stage(gs, [g.kernel.function for g in gs], TABLES, self.V) for gs in staged]
        self._ledgers = []
        for groups, stage in zip(staged, self._stages, strict=True):
            for g, values in zip(groups, stage.kernels, strict=True):
                if g.kernel.ledger is not None:
                    results = [np.zeros((g.n, 1)) for _ in range(g.kernel.ledger.n_out())]
                    self._ledgers.append((g.owner, BufferedFunction(g.kernel.ledger, values.arg, results)))
        self.rests, self.gap = plan.hold.rests.copy(), np.zeros(len(plan.hold))
        self._entry = {id(p): np.repeat(np.arange(p.nnz), np.diff(p.ptr)) for p in (plan.matrix, plan.derivative)}

    @property
    def resting(self) -> Array:
        """Rows that are left out, and unknowns that are 0 for them."""
        return self.plan.hold.of(self.rests)

    def residual(self, x: Array, v: Array, p: Array, h: float) -> Array:
        """R at (x, v, p, h); fills Y and V on the way, the values of condensed variables at the end of Y last."""
        plan, y = self.plan, self.Y
        y[: plan.nv] = v
        y[plan.nv :] = 0.0
        y[self.resting] = 0.0  # exactly, whatever rounding the factor leaves
        y[plan.nv :] += self._stages[0].sums(h, plan.nz, x, y, p)
        r = np.bincount(plan.const_row, plan.const_val * h**plan.const_pow * y[plan.const_src], plan.nrow).astype(float)
        r += self._stages[1].sums(h, plan.nrow, x, y, p)
        self._rest(r)
        y[len(y) - plan.ncondensed :] = r[plan.nrow - plan.ncondensed :]
        self.R = r
        return r

    def _rest(self, r: Array) -> None:
        """Set rows at rest to 0, after a look at their residuals: the mean of the node rows is (g' - g) / h."""
        plan = self.plan
        for c in np.flatnonzero(self.rests):
            rows = list(plan.hold.rows[c])
            self.gap[c] = max(abs(plan.weights @ r[rows[: plan.k]]), *np.abs(r[rows[plan.k :]]), 0.0)
            r[rows] = 0.0

    def matrix(self, h: float) -> Array:
        """Values of A from the current slots; rows at rest have 1 on the diagonal."""
        lists = self.plan.matrix
        values = self.products(lists, h)
        if not self.rests.any():
            return values
        rests = np.isin(lists.row, self.resting)
        return np.where(rests, (lists.row == lists.col).astype(float), values)

    def products(self, lists: Products, h: float) -> Array:
        """Values of a sparse matrix from the current slots."""
        terms = lists.value * h**lists.power * self.V[lists.s] * self.V[lists.t]
        return np.bincount(self._entry[id(lists)], terms, lists.nnz)

    def ledger(self, x: Array, p: Array) -> tuple[Array, Array, Array, Array]:
        """Per component: sums of `stored`, |stored|, `lost` and `numerical` at the last residual's Y."""
        n = self.plan.ncomp
        sums, moved = np.zeros((3, n)), np.zeros(n)
        for stage in self._stages:
            stage.take(x, self.Y, p)
        for owner, ledger in self._ledgers:
            ledger.call()
            for total, values in zip(sums, ledger.res, strict=False):
                total += np.bincount(owner, values[:, 0], n)
            moved += np.bincount(owner, np.abs(ledger.res[0][:, 0]), n)
        return sums[0], moved, sums[1], sums[2]


def carried(model: Model, s: State) -> Array:
    """[states | t], and the algebraic variables where a step carries them on."""
    return np.append(s.x, s.a) if model.step.carries else s.x


def inputs_at(model: Model, u: Array, at: Array) -> Array:
    """The polynomial through the node inputs u of a communication step, at the fractions `at` of it (stacked)."""
    k = model.step.k
    if k == 1 or not u.size:
        return np.tile(u, len(at)) if k == 1 else np.zeros(0)
    values, basis = u.reshape(k, -1), model.scheme.nodes
    if (values == values[0]).all():
        return np.tile(values[0], len(at))
    return np.concatenate([basis.value(float(c)) @ values for c in at])
