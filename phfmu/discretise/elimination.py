"""Symbolic LDL^T of a Schur matrix: elimination order, pattern of L, and the list of its updates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from phfmu.discretise.plan import Floats, Ints


@dataclass(frozen=True)
class Elimination:
    """S = sum over shared degrees of freedom of D_a D_b / m for rows a, b with gradients D, and its factor.

    Entries are numbered [diagonal | columns of L below it], by elimination position.
    `order`: position -> row;  `column`: first entry of each column;  `below`: row of each entry of L.
    `update`: entry[target] -= entry[left] entry[right] / diagonal, listed by column (`update_ptr`).
    `product`: sign, degree of freedom and gradient slots (a, b) of the terms of an entry (`product_ptr`).
    """

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


def eliminate(rows: Sequence[Sequence[tuple[int, int, float]]]) -> Elimination:
    """The elimination of rows given as lists of (degree of freedom, gradient slot, sign)."""
    n = len(rows)
    touched: dict[int, list[tuple[int, int, float]]] = {}
    for r, entries in enumerate(rows):
        for dof, slot, sign in entries:
            touched.setdefault(dof, []).append((r, slot, sign))
    products: dict[tuple[int, int], list[tuple[int, int, int, float]]] = {(r, r): [] for r in range(n)}
    for dof, found in touched.items():
        for i, (a, slot_a, sign_a) in enumerate(found):
            for b, slot_b, sign_b in found[: i + 1]:
                products.setdefault((max(a, b), min(a, b)), []).append((dof, slot_a, slot_b, sign_a * sign_b))
    pattern = ca.Sparsity.triplet(n, n, [a for a, _ in products], [b for _, b in products])
    order = (pattern + pattern.T).amd() if n else []
    place = {r: i for i, r in enumerate(order)}
    lower: list[set[int]] = [set() for _ in range(n)]
    for a, b in products:
        i, j = place[a], place[b]
        if i != j:
            lower[min(i, j)].add(max(i, j))
    for j in range(n):  # a column's rows are carried to its parent, the first of them
        if lower[j]:
            parent = min(lower[j])
            lower[parent] |= lower[j] - {parent}
    columns = [sorted(c) for c in lower]
    start = np.cumsum([n] + [len(c) for c in columns])
    entry = {(i, j): int(start[j]) + q for j, c in enumerate(columns) for q, i in enumerate(c)}
    entry |= {(j, j): j for j in range(n)}
    updates, update_ptr = [], [0]
    for j, c in enumerate(columns):
        updates += [(entry[(i, l)], entry[(i, j)], entry[(l, j)]) for q, l in enumerate(c) for i in c[q:]]
        update_ptr.append(len(updates))
    lists: list[list[tuple[int, int, int, float]]] = [[] for _ in entry]
    for (a, b), pairs in products.items():
        i, j = place[a], place[b]
        lists[entry[(max(i, j), min(i, j))]] += pairs
    flat = np.array([p for found in lists for p in found]).reshape(-1, 4)
    whole = flat[:, :3].astype(np.int32)
    update = np.array(updates, np.int32).reshape(-1, 3)
    return Elimination(
        order=np.array(order, np.int32), column=start.astype(np.int32),
        below=np.array([order[i] for c in columns for i in c], np.int32),
        update_ptr=np.array(update_ptr, np.int32), update_target=update[:, 0].copy(),
        update_left=update[:, 1].copy(), update_right=update[:, 2].copy(),
        product_ptr=np.cumsum([0] + [len(p) for p in lists]).astype(np.int32),
        product_dof=whole[:, 0].copy(), product_a=whole[:, 1].copy(), product_b=whole[:, 2].copy(),
        product_sign=flat[:, 3].copy(),
    )  # fmt: skip
