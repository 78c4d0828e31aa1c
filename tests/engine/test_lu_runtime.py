"""Sparse LU of the runtime against scipy: random matrices, refactorisation, singularity, capacity."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csc_matrix, random_array
from scipy.sparse.linalg import splu

from phfmu import Collocated, PythonInstance, TwoLevel, build_model
from phfmu.components.mechanical.chain import chain
from phfmu.engine.build.compile import compile
from phfmu.engine.build.runtime_sources import RUNTIME
from phfmu.outcome.status import Status

DRIVER = """
#include <stdlib.h>
#include "system.h"
PH_API ph_lu *lu_new(int n, int nnz, int capacity, const int *colptr, const int *rowind, const int *order,
                     const int *prefer) {
    ph_lu *lu = calloc(1, sizeof(ph_lu));
    int **ints[] = {&lu->pivot, &lu->where, &lu->start, &lu->lower, &lu->mark, &lu->stack, &lu->child};
    for (int i = 0; i < 7; i++) *ints[i] = calloc((size_t)n + 1, sizeof(int));
    lu->n = n;
    lu->nnz = nnz;
    lu->capacity = capacity;
    lu->colptr = colptr;
    lu->rowind = rowind;
    lu->order = order;
    lu->prefer = prefer;
    lu->index = calloc((size_t)capacity + 1, sizeof(int));
    lu->value = calloc((size_t)capacity + 1, sizeof(double));
    lu->inverse = calloc((size_t)n + 1, sizeof(double));
    lu->work = calloc((size_t)n + 1, sizeof(double));
    lu->place = calloc((size_t)nnz + 1, sizeof(int));
    return lu;
}
PH_API int lu_factor(ph_lu *lu, const double *a, long long *count) { return ph_lu_factor(lu, a, count); }
PH_API int lu_forced(ph_lu *lu, const double *a, double forced) { return ph_lu_forced(lu, a, forced); }
PH_API int lu_refactor(ph_lu *lu, const double *a) { return ph_lu_refactor(lu, a); }
PH_API int lu_adopt(ph_lu *lu, const int *pivot) { return ph_lu_adopt(lu, pivot); }
PH_API void lu_forget(ph_lu *lu) { lu->ready = lu->filled = 0; lu->stack[0] = -7; }
PH_API int lu_walked(ph_lu *lu) { return lu->stack[0] != -7; } /* whether the pattern was made anew */
PH_API void lu_solve(ph_lu *lu, const double *b, double *x) { ph_lu_solve(lu, b, x); }
PH_API const int *lu_pivot(ph_lu *lu) { return lu->pivot; }
PH_API int lu_entries(ph_lu *lu) { return lu->start[lu->n]; }
PH_API int lu_products(ph_lu *lu) { /* of a factorisation */
    int n = 0;
    for (int j = 0; j < lu->n; j++)
        for (int q = lu->start[j]; q < lu->lower[j]; q++)
            n += lu->start[lu->index[q] + 1] - lu->lower[lu->index[q]];
    return n;
}
PH_API int lu_failed(ph_lu *lu) { return lu->failed; }
"""
FACTORED, PIVOTED = 3, 4  # counters of phfmu.h


@pytest.fixture(scope="module")
def lib() -> ctypes.CDLL:
    sources = {"lu.c": RUNTIME / "lu.c", "driver.c": DRIVER}
    headers = {p.name: p for p in RUNTIME.rglob("*.h")}
    library = ctypes.CDLL(str(compile({**sources, **headers}).path))
    library.lu_new.restype = library.lu_pivot.restype = ctypes.c_void_p
    return library


class LU:
    """One factorisation object of the runtime."""

    def __init__(self, lib: ctypes.CDLL, a: Any, capacity: int | None = None, order: Any = None) -> None:
        n = int(a.shape[0])
        self.lib, self.n = lib, n
        self.tables = [np.asarray(t, np.int32) for t in (a.indptr, a.indices)]
        order = np.arange(n) if order is None else order
        self.tables += [np.asarray(order, np.int32), np.asarray(order, np.int32)]
        pointers = [ctypes.c_void_p(t.ctypes.data) for t in self.tables]
        room = n * n if capacity is None else capacity
        self.p = ctypes.c_void_p(lib.lu_new(n, a.nnz, room, *pointers))
        self.count = np.zeros(16, np.int64)

    def factor(self, a: Any) -> Status:
        data = np.ascontiguousarray(a.data)
        count = ctypes.c_void_p(self.count.ctypes.data)
        return list(Status)[self.lib.lu_factor(self.p, ctypes.c_void_p(data.ctypes.data), count)]

    def solve(self, b: np.ndarray) -> np.ndarray:
        x = np.empty(self.n)
        self.lib.lu_solve(self.p, b.ctypes.data_as(ctypes.c_void_p), x.ctypes.data_as(ctypes.c_void_p))
        return x

    def pivots(self) -> np.ndarray:
        p = ctypes.cast(self.lib.lu_pivot(self.p), ctypes.POINTER(ctypes.c_int))
        return np.ctypeslib.as_array(p, (self.n,)).copy()


def matrix(n: int, density: float, seed: int, weak: bool = False) -> Any:
    """Nonsingular random matrix; weak: zeros on parts of the diagonal, as multipliers have."""
    rng = np.random.default_rng(seed)
    a = random_array((n, n), density=density, rng=rng, format="csc")
    a.data = rng.normal(size=a.nnz)
    shift = rng.permutation(n) if weak else np.arange(n)
    strong = csc_matrix((rng.uniform(1, 2, n), (shift, np.arange(n))), shape=(n, n))
    result = csc_matrix(a + strong)
    result.sort_indices()
    return result


@settings(max_examples=60, deadline=None)
@given(n=st.integers(1, 300), fill=st.floats(0.5, 6.0), seed=st.integers(0, 10**6), weak=st.booleans())
def test_solves_like_scipy(lib: ctypes.CDLL, n: int, fill: float, seed: int, weak: bool) -> None:
    rng = np.random.default_rng(seed)
    a = matrix(n, min(1.0, fill / n), seed, weak)
    lu = LU(lib, a, order=rng.permutation(n))
    assert lu.factor(a) is Status.OK
    b = rng.normal(size=n)
    x = lu.solve(b)
    scale = np.abs(a).sum(axis=1).max() * np.abs(x).max() + np.abs(b).max()
    assert np.abs(a @ x - b).max() <= 1e-11 * scale
    reference = splu(a).solve(b)
    assert np.abs(x - reference).max() <= 1e-6 * np.abs(reference).max()


@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 200), seed=st.integers(0, 10**6))
def test_refactorisation_has_the_bits_of_a_fresh_one(lib: ctypes.CDLL, n: int, seed: int) -> None:
    """Old pivots with new numbers = pattern rebuilt from those pivots with the same numbers."""
    a = matrix(n, min(1.0, 3.0 / n), seed)
    b = a.copy()
    b.data = a.data * (1 + 1e-3 * np.random.default_rng(seed).normal(size=a.nnz))
    first, second = LU(lib, a), LU(lib, a)
    assert first.factor(a) is Status.OK
    pivots = first.pivots()
    assert lib.lu_adopt(second.p, pivots.ctypes.data_as(ctypes.c_void_p)) == 0
    assert first.factor(b) is Status.OK and second.factor(b) is Status.OK
    rhs = np.ones(n)
    if first.count[PIVOTED] == 1 and second.count[PIVOTED] == 0:
        assert np.array_equal(first.pivots(), second.pivots())
        assert first.solve(rhs).tobytes() == second.solve(rhs).tobytes()


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 200), seed=st.integers(0, 10**6), change=st.sampled_from([0.0, 1e-3, 0.3, 3.0]), weak=st.booleans()
)
def test_a_search_after_factors_has_the_bits_of_a_fresh_one(
    lib: ctypes.CDLL, n: int, seed: int, change: float, weak: bool
) -> None:
    """What was factored before shows in no bit of a search, however far the numbers have moved, ties and all."""
    rng = np.random.default_rng(seed)
    a = matrix(n, min(1.0, 3.0 / n), seed, weak)
    if rng.random() < 0.3:
        a.data = np.round(a.data) + (a.data == 0)  # many of a size
    b = a.copy()
    b.data = a.data * (1 + change * rng.normal(size=a.nnz))
    prefer = np.where(rng.random(n) < 0.5, rng.permutation(n), -1)
    first, second = LU(lib, a), LU(lib, a)
    for lu in (first, second):
        lu.tables[3][:] = prefer
    if first.factor(a) is not Status.OK:
        return
    lib.lu_forget(first.p)
    found = first.factor(b)
    assert found is second.factor(b)
    assert (first.count[PIVOTED], second.count[PIVOTED]) == (2, 1)
    if found is not Status.OK:
        return
    assert np.array_equal(first.pivots(), second.pivots())
    rhs = rng.normal(size=n)
    assert first.solve(rhs).tobytes() == second.solve(rhs).tobytes()


def test_a_search_that_finds_the_same_makes_no_pattern(lib: ctypes.CDLL) -> None:
    """It goes through the factors there are; one that finds others makes theirs."""
    a = csc_matrix(np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 1.0], [0.0, 1.0, 2.0]]))
    lu, other = LU(lib, a), a.copy()
    other[0, 0] = 1e-4
    assert lu.factor(a) is Status.OK
    for now, walks in ((1.2 * a, 0), (other, 1)):
        lib.lu_forget(lu.p)
        assert lu.factor(now) is Status.OK and lib.lu_walked(lu.p) == walks


def test_refactorisation_is_used_and_left(lib: ctypes.CDLL) -> None:
    """Small changes keep the pivots, a vanishing pivot brings a new search; the old pivots are not forced."""
    a = csc_matrix(np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 1.0], [0.0, 1.0, 2.0]]))
    lu = LU(lib, a)
    for factor in (1.0, 1.1, 0.9):
        assert lu.factor(factor * a) is Status.OK
    assert (lu.count[FACTORED], lu.count[PIVOTED]) == (3, 1)
    b = a.copy()
    b.data = np.where(b.data == 4.0, 1e-9, b.data)
    assert lu.factor(b) is Status.OK
    assert lu.count[PIVOTED] == 2
    assert np.allclose(b @ lu.solve(np.ones(3)), 1.0, rtol=0, atol=1e-13)


def test_preferred_pivot_within_a_hundredth(lib: ctypes.CDLL) -> None:
    for small, kept in ((0.02, True), (0.005, False)):
        a = csc_matrix(np.array([[small, 1.0], [1.0, 1.0]]))
        lu = LU(lib, a)
        assert lu.factor(a) is Status.OK
        assert bool(lu.pivots()[0] == 0) is kept


@pytest.mark.parametrize("a", [[[1.0, 2.0], [2.0, 4.0]], [[0.1, 0.3], [0.3, 0.9]], [[1.0, 1.0], [0.0, 0.0]]])
def test_singular(lib: ctypes.CDLL, a: list[list[float]]) -> None:
    full = csc_matrix((np.array(a).T.ravel(), np.array([0, 1, 0, 1]), np.array([0, 2, 4])), shape=(2, 2))
    lu = LU(lib, full)
    assert lu.factor(full) is Status.SINGULAR
    assert lib.lu_failed(lu.p) == 1
    good = full.copy()
    good.data = np.array([1.0, 2.0, 3.0, 4.0])
    assert lu.factor(good) is Status.OK
    assert np.allclose(good @ lu.solve(np.ones(2)), 1.0)


@pytest.mark.parametrize(
    ("a", "status"),
    [
        ([[0.1, 0.3], [0.3, 0.9]], Status.OK),
        ([[1.0, 2.0], [2.0, 4.0]], Status.SINGULAR),
        ([[1.0, 0.0], [1.0, 0.0]], Status.SINGULAR),
    ],
)
def test_forced_pivots_meet_rows_that_agree(lib: ctypes.CDLL, a: list[list[float]], status: Status) -> None:
    """A column of which rounding is left gets a pivot, one of which nothing is left gets none; the next factors
    have their own."""
    full = csc_matrix((np.array(a).T.ravel(), np.array([0, 1, 0, 1]), np.array([0, 2, 4])), shape=(2, 2))
    lu = LU(lib, full)
    assert lu.factor(full) is Status.SINGULAR
    data = ctypes.c_void_p(full.data.ctypes.data)
    assert list(Status)[lib.lu_forced(lu.p, data, ctypes.c_double(1e-8))] is status
    if status is Status.OK:
        b = full @ np.array([3.0, -1.0])
        assert np.allclose(full @ lu.solve(b), b, rtol=0, atol=1e-7)
    assert lu.factor(full) is Status.SINGULAR


@pytest.mark.slow
@pytest.mark.parametrize("scheme", [Collocated(1), TwoLevel(1)])
def test_what_derivatives_of_a_chain_take_grows_with_its_length(
    lib: ctypes.CDLL, scheme: Collocated | TwoLevel
) -> None:
    """Entries of the factors and products of a factorisation: as many for each further link; those of the derivatives stay."""
    sizes = []
    for links in (10, 20, 40):
        model = build_model(chain(links, port=True), scheme)
        one, plan = PythonInstance(model), model.step
        one.do_step(0.0, 1e-3)
        one.sensitivity()
        a = csc_matrix(
            (one._solves._newton.evaluator.matrix(1e-3), plan.matrix.row, plan.colptr), shape=(plan.nw, plan.nw)
        )
        a.data *= (1.0 / np.abs(a).max(axis=1).toarray().ravel())[a.indices]
        lu = LU(lib, a, order=plan.order)
        lu.tables[3][:] = plan.pivot_row
        assert lu.factor(a) is Status.OK
        sizes.append([len(plan.derivative.row), lib.lu_entries(lu.p), lib.lu_products(lu.p)])
    short, middle, long = np.array(sizes)
    assert (long - middle <= 2.2 * (middle - short)).all() and (middle[1:] > short[1:]).all()


def test_capacity(lib: ctypes.CDLL) -> None:
    a = matrix(40, 0.1, 3)
    needed = LU(lib, a)
    assert needed.factor(a) is Status.OK
    entries = lib.lu_entries(needed.p)
    assert LU(lib, a, capacity=entries + 1).factor(a) is Status.OK
    assert LU(lib, a, capacity=entries // 2).factor(a) is Status.LU_CAPACITY


def test_not_finite_is_not_accepted(lib: ctypes.CDLL) -> None:
    a = csc_matrix(np.array([[np.nan, 1.0], [1.0, 1.0]]))
    lu = LU(lib, a)
    if lu.factor(a) is Status.OK:
        assert not np.isfinite(lu.solve(np.ones(2))).all()
