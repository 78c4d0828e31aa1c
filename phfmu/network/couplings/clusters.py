"""Bare columns that S couples: those that a member with impulses joins; S is a block for each such cluster."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


class Clusters:
    """`reached`: the bare columns of each member with impulses, numbers below n; `of`: the columns of each cluster."""

    def __init__(self, reached: Sequence[Ints], n: int):
        pairs = [r for r in reached if len(r)]
        rows = np.concatenate([np.full(len(p), p[0]) for p in pairs] or [np.zeros(0, int)])
        columns = np.concatenate([*pairs, np.zeros(0, int)])
        graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
        count, label = connected_components(graph, directed=False) if n else (0, np.zeros(0, int))
        order = np.argsort(label, kind="stable")
        self.of = np.split(order, np.searchsorted(label[order], np.arange(1, count))) if n else []
        self._label, self._place = label, np.zeros(n, int)
        for own in self.of:
            self._place[own] = np.arange(len(own))

    def blank(self) -> list[Array]:
        """S = 0."""
        return [np.zeros((len(own),) * 2) for own in self.of]

    def add(self, S: list[Array], columns: Ints, part: Array) -> None:
        """S += part, of the bare columns of one member."""
        if len(columns):
            own = self._place[columns]
            S[self._label[columns[0]]][own[:, None], own] += part

    def form(self, S: list[Array], x: Array) -> float:
        """x S x."""
        return float(sum(x[own] @ s @ x[own] for own, s in zip(self.of, S, strict=True)))

    def times(self, T: list[Array], x: Array) -> Array:
        """T x."""
        out = np.zeros_like(x)
        for own, t in zip(self.of, T, strict=True):
            out[own] = t @ x[own]
        return out
