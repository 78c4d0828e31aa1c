"""Maximum matchings, beside those of SciPy: the same pairs, not only as many."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from phfmu.matching import columns_of_rows, maximum_matching


@st.composite
def patterns(draw: st.DrawFn) -> tuple[list[tuple[int, int]], int, int]:
    m, n = draw(st.integers(0, 12)), draw(st.integers(0, 12))
    places = st.tuples(st.integers(0, max(m - 1, 0)), st.integers(0, max(n - 1, 0)))
    return draw(st.lists(places, max_size=40)) if m and n else [], m, n


def found(places: list[tuple[int, int]], m: int, n: int) -> list[int]:
    row, col = (np.array([p[i] for p in places], np.int32) for i in (0, 1))
    return maximum_matching(columns_of_rows(row, col, m, n), n)


def of_scipy(places: list[tuple[int, int]], m: int, n: int) -> list[int]:
    row, col = ([p[i] for p in places] for i in (0, 1))
    pattern = csr_matrix((np.ones(len(places), bool), (row, col)), shape=(m, n))
    return maximum_bipartite_matching(pattern, perm_type="column").tolist()


@given(patterns())
def test_the_pairs_are_those_of_scipy(pattern: tuple[list[tuple[int, int]], int, int]) -> None:
    assert found(*pattern) == of_scipy(*pattern)


def test_also_in_large_patterns() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        m, n, entries = (int(k) for k in rng.integers(50, 400, 3))
        places = list(
            zip(rng.integers(0, m, 2 * entries).tolist(), rng.integers(0, n, 2 * entries).tolist(), strict=True)
        )
        assert found(places, m, n) == of_scipy(places, m, n)


def test_each_pair_is_an_entry_and_no_column_is_taken_twice() -> None:
    rows = [[0], [0, 1], [1, 2], [2], [2]]
    match = maximum_matching(rows, 4)
    pairs = [(r, c) for r, c in enumerate(match) if c >= 0]
    assert len(pairs) == len({c for _, c in pairs}) == 3 and all(c in rows[r] for r, c in pairs)
