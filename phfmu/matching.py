"""Maximum matchings of bipartite graphs: as many rows of a pattern as can be, each with a column of its own that it contains.

Source: Hopcroft, Karp, SIAM J. Comput. 2 (1973).  The matching is that of `scipy.sparse.csgraph.maximum_bipartite_matching`,
whose import takes longer than a model of some hundred unknowns needs for all of its planning.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

#: the level of what no path has reached
FAR = sys.maxsize


def columns_of_rows(row: NDArray[np.integer], col: NDArray[np.integer], m: int, n: int) -> list[list[int]]:
    """The columns of each of m rows, in ascending order and each once, from the places (row, col) of a pattern with n columns."""
    entries = np.unique(row.astype(np.int64) * n + col)
    columns = (entries % max(n, 1)).tolist()
    first = np.searchsorted(entries, np.arange(m + 1) * n).tolist()
    return [columns[begin:end] for begin, end in pairwise(first)]


def maximum_matching(rows: Sequence[Sequence[int]], n: int) -> list[int]:
    """Row -> the column it is matched with, -1 for none; rows: the columns of each in ascending order, out of n."""
    found = _Matching(rows, n)
    while (level := found.levels())[-1] < FAR:
        for row, column in enumerate(found.column_of):
            if column < 0:
                found.augment(row, level)
    return found.column_of


class _Matching:
    """A matching on its way to the maximum; the owner of a free column is one past the last row."""

    def __init__(self, rows: Sequence[Sequence[int]], n: int):
        self._rows, self._free = rows, len(rows)
        self.column_of, self._row_of = [-1] * len(rows), [len(rows)] * n

    def levels(self) -> list[int]:
        """Rows by the length of the shortest alternating path to them from any free row; at the end, that of free columns."""
        level = [0 if column < 0 else FAR for column in self.column_of] + [FAR]
        reached = [row for row, column in enumerate(self.column_of) if column < 0]
        for row in reached:  # which grows
            if level[row] < level[self._free]:
                for owner in map(self._row_of.__getitem__, self._rows[row]):
                    if level[owner] == FAR:
                        level[owner] = level[row] + 1
                        reached.append(owner)
        return level

    def augment(self, root: int, level: list[int]) -> None:
        """Match a free row along a shortest path that shares no row with those before, if there is one left."""
        stack, before = [root], dict[int, int]()
        while stack:
            row = stack.pop()
            for column in self._rows[row]:
                owner = self._row_of[column]
                if level[owner] != level[row] + 1:
                    continue
                if owner == self._free:
                    self._flip(root, row, column, before, level)
                    return
                stack.append(owner)
                before[owner] = row

    def _flip(self, root: int, row: int, column: int, before: dict[int, int], level: list[int]) -> None:
        """Give each row of the path the column through which it was left."""
        while True:
            level[row] = FAR
            self._row_of[column] = row
            self.column_of[row], column = column, self.column_of[row]
            if row == root:
                return
            row = before[row]
