"""Symbolic LDL^T of a Schur matrix: elimination order, pattern of L, and the list of its updates."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from phfmu.plan.plan import Floats, Ints

#: trailing columns of at least so many, of whose entries at most this share is filled up with zeros, are eliminated as a
#: full block by loops: their updates need no list
BLOCK = 48
FILLED = 0.3

#: gradients of a row: (degree of freedom, gradient slot, sign)
Row = Sequence[tuple[int, int, float]]


@dataclass(frozen=True)
class Elimination:
    """S = sum over shared degrees of freedom of D_a D_b / m for rows a, b with gradients D, and its factor.

    Entries are numbered [diagonal | columns of L below it], by elimination position.
    `order`: position -> row;  `column`: first entry of each column;  `below`: row of each entry of L.
    `update`: entry[target] -= entry[left] entry[right] / diagonal, listed by column (`update_ptr`).
    `full`: from this position on columns of L have no gaps (some entries may be zero), and their updates are not listed.
    `product`: sign, degree of freedom and gradient slots (a, b) of the terms of an entry (`product_ptr`).
    """

    full: int
    order: Ints
    column: Ints
    below: Ints
    update_ptr: Ints
    update_target: Ints
    update_left: Ints
    update_right: Ints
    product_ptr: Ints
    product_dof: Ints
    product_a: Ints
    product_b: Ints
    product_sign: Floats

    @property
    def n(self) -> int:
        return len(self.order)

    @property
    def nentry(self) -> int:
        return len(self.product_ptr) - 1


class FactorPattern:
    """Order and pattern of L for given rows: the cost of an elimination, before its lists are made."""

    def __init__(self, rows: Sequence[Row], light: Sequence[int] = (), unit: int = 0):
        """`light`: degrees of freedom with a row of their own behind the others, the transposed column of their gradients,
        which are multiplied by that of slot `unit`; its diagonal has no products.
        """
        rows = list(rows)
        self.n = len(rows) + len(light)
        touched: dict[int, list[tuple[int, int, float]]] = {}
        for r, entries in enumerate(rows):
            for dof, slot, sign in entries:
                touched.setdefault(dof, []).append((r, slot, sign))
        self.products: dict[tuple[int, int], list[tuple[int, int, int, float]]] = {(r, r): [] for r in range(self.n)}
        for r, dof in enumerate(light, len(rows)):
            for a, slot, sign in touched.get(dof, ()):
                self.products.setdefault((r, a), []).append((dof, unit, slot, sign))
        for dof, found in touched.items():
            for i, (a, slot_a, sign_a) in enumerate(found):
                for b, slot_b, sign_b in found[: i + 1]:
                    key = (max(a, b), min(a, b))
                    self.products.setdefault(key, []).append((dof, slot_a, slot_b, sign_a * sign_b))
        pattern = ca.Sparsity.triplet(self.n, self.n, [a for a, _ in self.products], [b for _, b in self.products])
        pattern = pattern + pattern.T
        self.order = pattern.amd() if self.n else []
        if light:
            self.order = delayed(self.order, self.products, len(rows))
        lower = factor_pattern(pattern, self.order)
        self.start = np.array(lower.colind(), np.int64)
        self.below = np.array(lower.row(), np.int64)
        self.full = self._filled_up()

    def _filled_up(self) -> int:
        """Fill the last columns up to a block without gaps where that adds little; the block's first position."""
        n = self.n
        size = np.arange(n, 0, -1)  # of the block from each position on
        room, there = size * (size - 1) // 2, self.start[-1] - self.start[:-1]
        fits = np.flatnonzero((size >= BLOCK) & (there >= (1 - FILLED) * room))
        if not len(fits):
            return n
        first = int(fits[0])
        self.below = np.concatenate([self.below[: self.start[first]], *(np.arange(j + 1, n) for j in range(first, n))])
        self.start[first:] = self.start[first] + np.cumsum([0, *range(n - 1 - first, -1, -1)])
        return first

    @property
    def updates(self) -> int:
        """Multiplications and subtractions of the factor."""
        return updates(self.start)

    def elimination(self) -> Elimination:
        """The lists of the factor."""
        n, full = self.n, self.full
        lists = [self._updates(j) for j in range(full)]
        target, left, right = np.hstack([np.zeros((3, 0), np.int64), *lists]).astype(np.int32)
        pointer = np.cumsum([0] + [u.shape[1] for u in lists] + [0] * (n - full))
        place = {r: i for i, r in enumerate(self.order)}
        terms: list[list[tuple[int, int, int, float]]] = [[] for _ in range(n + len(self.below))]
        for (a, b), pairs in self.products.items():
            i, j = place[a], place[b]
            terms[self._entry(max(i, j), min(i, j))] += pairs
        flat = np.array([p for found in terms for p in found]).reshape(-1, 4)
        whole = flat[:, :3].astype(np.int32)
        return Elimination(
            full=full, order=np.array(self.order, np.int32), column=(n + self.start).astype(np.int32),
            below=np.array(self.order, np.int32)[self.below], update_ptr=pointer.astype(np.int32),
            update_target=target.copy(), update_left=left.copy(), update_right=right.copy(),
            product_ptr=np.cumsum([0] + [len(p) for p in terms]).astype(np.int32),
            product_dof=whole[:, 0].copy(), product_a=whole[:, 1].copy(), product_b=whole[:, 2].copy(),
            product_sign=flat[:, 3].copy(),
        )  # fmt: skip

    def _entry(self, i: int, j: int) -> int:
        """Number of the entry (i, j), i >= j by position."""
        if i == j:
            return j
        first, last = self.start[j], self.start[j + 1]
        return int(self.n + first + np.searchsorted(self.below[first:last], i))

    def _updates(self, j: int) -> np.ndarray:
        """Targets, left and right factors of the updates of later columns by column j (3 x updates)."""
        first, last = int(self.start[j]), int(self.start[j + 1])
        rows, entries = self.below[first:last], self.n + np.arange(first, last)
        parts = [np.zeros((3, 0), np.int64)]
        for q, l in enumerate(rows):
            column = self.below[self.start[l] : self.start[l + 1]]
            below = self.n + self.start[l] + np.searchsorted(column, rows[q + 1 :])
            target = np.concatenate([[l], below])
            parts.append(np.stack([target, entries[q:], np.full(len(target), entries[q])]))
        return np.hstack(parts)


def factor_pattern(pattern: ca.Sparsity, order: Sequence[int]) -> ca.Sparsity:
    """Pattern of the strictly lower L with L D L^T = A[order, order] for a symmetric pattern A."""
    if not len(order):
        return ca.Sparsity(0, 0)
    upper, _ = pattern.sub(list(order), list(order))[0].ldl(False)
    return upper.T


def delayed(order: Sequence[int], entries: Iterable[tuple[int, int]], first: int) -> list[int]:
    """The order with the rows from `first` on behind all those they share an entry with: before them they have no pivot."""
    place = {r: i for i, r in enumerate(order)}
    key = {r: (i, 0) for r, i in place.items()}
    for r, a in entries:
        if r >= first > a:
            key[r] = max(key[r], (place[a], 1 + place[r]))
    return sorted(order, key=lambda r: key[r])


def updates(column: np.ndarray) -> int:
    """Multiply-and-subtract operations of a factor whose columns of L have the lengths diff(column)."""
    counts = np.diff(column)
    return int(np.sum(counts * (counts + 1)) // 2)


def eliminate(rows: Sequence[Row], light: Sequence[int] = (), unit: int = 0) -> Elimination:
    """The elimination of rows given as lists of (degree of freedom, gradient slot, sign)."""
    return FactorPattern(rows, light, unit).elimination()
