"""Compensated sums: the same bits however a run is cut into rows and blocks, by arrays or in compiled code."""

import ctypes
import math
import threading
from collections.abc import Sequence
from contextlib import suppress
from itertools import accumulate, chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.integer]


class CompensatedSum:
    """Sum = high + low: the rounding error of every addition is found exactly and summed beside it."""

    __slots__ = ("high", "low")

    def __init__(self) -> None:
        self.high = 0.0
        self.low = 0.0

    @property
    def value(self) -> float:
        return self.high + self.low

    def add(self, x: float) -> float:
        """Add one number and return the sum."""
        after = self.high + x
        part = after - self.high
        error = (self.high - (after - part)) + (x - part)
        self.high = after
        if math.isfinite(error):
            self.low += error
        return after + self.low

    def extend(self, x: Floats) -> Floats:
        """Add x [n] one after the other and return the n running sums [n]."""
        return extend([self], x[:, None])[:, 0]


class _Scratch(threading.local):
    """Memory that sums of blocks are made in: large arrays that are new each time cost more than what is done in them."""

    def __init__(self) -> None:
        self._parts = np.empty((4, 0))

    def arrays(self, m: int, n: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Two (m x n + 1), two (m x n), of any content; valid until the next call."""
        size = m * (n + 1)
        if self._parts.shape[1] < size:
            self._parts = np.empty((4, size))
        sums, lows, x, part = self._parts[:, :size]
        return sums.reshape(m, n + 1), lows.reshape(m, n + 1), x[: m * n].reshape(m, n), part[: m * n].reshape(m, n)


_SCRATCH = _Scratch()
#: the compiled library once a run is long enough for it
_library: Any = None


def use_compiled() -> None:
    """Sums in compiled code from now on: the same bits; where there is no compiler they stay as they are."""
    global _library
    if _library is None:
        from phfmu.engine.build.compile import CompileError, CompilerMissing

        with suppress(CompilerMissing, CompileError, OSError):
            _library = _summing_library()


def _summing_library() -> Any:
    """The functions of runtime/sums.c, of this module and of the pass of `ordinary.py`; raises CompilerMissing, CompileError."""
    from phfmu.engine.native.library import summing

    lib = summing()
    size, pointer = ctypes.c_ssize_t, ctypes.c_void_p
    lib.ph_sums_down.restype = lib.ph_sums_across.restype = lib.ph_most_down.restype = None
    lib.ph_sums_down.argtypes = [size, size, *[pointer] * 4]
    lib.ph_sums_across.argtypes = [size, size, pointer, size, *[pointer] * 3]
    lib.ph_most_down.argtypes = [size, size, pointer, pointer]
    lib.ph_ordinary.argtypes = [pointer, size]
    return lib


def compiled() -> Any:
    """The compiled library, if it is in use."""
    return _library


def extend(sums: Sequence[CompensatedSum], x: Floats) -> Floats:
    """Add column j of x [n,m] to sum j, row after row, and return the running sums [n,m]."""
    if len(x) == 1:
        return np.array([[each.add(value) for each, value in zip(sums, x[0].tolist(), strict=True)]])
    if _library is not None:
        return _down(sums, x, np.empty(x.shape))
    high, low = _running(sums, x)
    return (high + low).T


def add(sums: Sequence[CompensatedSum], x: Floats) -> None:
    """`extend` without the running sums."""
    if len(x) == 1:
        extend(sums, x)
    elif _library is not None:
        _down(sums, x, None)
    else:
        _running(sums, x)


def _down(sums: Sequence[CompensatedSum], x: Floats, running: Floats | None) -> Any:
    """`_running` in compiled code; into `running` [n,m] the running sums."""
    x, ends = np.ascontiguousarray(x), np.array([[s.high for s in sums], [s.low for s in sums]])
    out = None if running is None else running.ctypes.data
    _library.ph_sums_down(*x.shape, x.ctypes.data, ends[0].ctypes.data, ends[1].ctypes.data, out)
    for s, h, w in zip(sums, *ends.tolist(), strict=True):
        s.high, s.low = h, w
    return running


def _running(sums: Sequence[CompensatedSum], x: Floats) -> tuple[Floats, Floats]:
    """`CompensatedSum.add` down the columns of x [n,m]; the running high and low parts [m,n], in scratch memory."""
    high, low, terms, part = _SCRATCH.arrays(x.shape[1], len(x))
    terms[:] = x.T  # a sum runs over what lies side by side
    high[:, 0], low[:, 0] = [s.high for s in sums], [s.low for s in sums]
    before, after, error = high[:, :-1], high[:, 1:], low[:, 1:]
    after[:] = terms
    with np.errstate(invalid="ignore", over="ignore"):
        np.add.accumulate(high, axis=1, out=high)
        _error(before, terms, after, error, part)
        np.add.accumulate(low, axis=1, out=low)
    for s, h, w in zip(sums, high[:, -1].tolist(), low[:, -1].tolist(), strict=True):
        s.high, s.low = h, w
    return after, error


def _error(before: Floats, x: Floats, after: Floats, error: Floats, part: Floats) -> Floats:
    """The rounding of the addition after = before + x, into `error`; `part` is overwritten."""
    np.subtract(after, before, out=part)
    np.subtract(after, part, out=error)
    np.subtract(before, error, out=error)
    np.subtract(x, part, out=part)
    error += part
    if not all_finite(error):
        error[~np.isfinite(error)] = 0.0
    return error


class Sums:
    """Compensated sums by name; one that was never added to is absent."""

    def __init__(self) -> None:
        self._parts: dict[tuple[str, ...], CompensatedSum] = {}

    def __getitem__(self, key: tuple[str, ...]) -> CompensatedSum:
        found = self._parts.get(key)
        if found is None:
            found = self._parts[key] = CompensatedSum()
        return found

    def extend(self, keys: Sequence[tuple[str, ...]], x: Floats) -> Floats:
        """Add columns of x [n,m] to m sums; the running sums [n,m]."""
        return extend([self[key] for key in keys], x) if keys else x

    def add(self, keys: Sequence[tuple[str, ...]], x: Floats) -> None:
        """`extend` without the running sums."""
        if keys:
            add([self[key] for key in keys], x)

    def get(self, *key: str) -> float | None:
        return self._parts[key].value if key in self._parts else None


def across(x: Floats) -> Floats:
    """Sum over the columns of x [n,m], each row compensated; zeros for none."""
    return across_each(x, [range(x.shape[1])])[:, 0]


def across_each(x: Floats, groups: Sequence[Sequence[int]]) -> Floats:
    """Sums over g groups of columns of x [n,m], each row compensated; [n,g]."""
    if _library is None:
        return np.stack([_across(x[:, list(at)]) for at in groups], axis=1) if groups else np.zeros((len(x), 0))
    x, out = np.ascontiguousarray(x), np.empty((len(x), len(groups)))
    end, at = (np.array(list(own), np.intp) for own in (accumulate(map(len, groups)), chain(*groups)))
    _library.ph_sums_across(*x.shape, x.ctypes.data, len(groups), end.ctypes.data, at.ctypes.data, out.ctypes.data)
    return out


def _across(x: Floats) -> Floats:
    high, low, error, part = np.zeros(len(x)), np.zeros(len(x)), np.empty(len(x)), np.empty(len(x))
    with np.errstate(invalid="ignore", over="ignore"):
        for column in np.ascontiguousarray(x.T):
            after = high + column
            low += _error(high, column, after, error, part)
            high = after
    return high + low


def plain(x: Floats, groups: Sequence[Sequence[int]]) -> Floats:
    """`across_each` as exact as allowances need: one addition after the other."""
    out = np.zeros((len(groups), len(x)))
    columns = np.ascontiguousarray(x.T)
    with np.errstate(invalid="ignore", over="ignore"):
        for own, at in zip(out, groups, strict=True):
            for j in at:
                own += columns[j]
    return out.T


def rows(x: Floats) -> Floats:
    """`across` as exact as allowances need."""
    return plain(x, [range(x.shape[1])])[:, 0]


def largest_so_far(start: Sequence[float], x: Floats) -> Floats:
    """Largest of start [m] and x [n,m] up to each row; x is of numbers only, and overwritten."""
    most = np.array(start)
    if _library is None:
        return np.maximum(np.maximum.accumulate(x, axis=0, out=x), most, out=x)
    assert x.flags.c_contiguous
    _library.ph_most_down(*x.shape, x.ctypes.data, most.ctypes.data)
    return x


def all_finite(x: Floats) -> bool:
    """Whether all are finite numbers."""
    return bool(np.isfinite(x).all())


def larger(a: float, b: float) -> float:
    """The larger of a >= 0 and |b|; what is not a finite number counts as infinite."""
    return max(a, abs(b)) if math.isfinite(b) else math.inf


def largest(x: Floats) -> float:
    """Largest magnitude in x, 0 for none; what is not a finite number counts as infinite."""
    size = np.abs(x)
    return float(np.max(size if all_finite(size) else np.where(np.isfinite(x), size, np.inf), initial=0.0))


def ratio(size: ArrayLike, allowed: ArrayLike) -> Floats:
    """|size| / allowed elementwise: 0 for 0/0, infinite where one of them is not a finite number."""
    r, m = np.abs(np.asarray(size, float)), np.asarray(allowed, float)
    if all_finite(r) and all_finite(m) and m.min(initial=1.0) > 0.0:
        return r / m
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = np.where(r == 0.0, 0.0, r / m)
    return np.where(np.isfinite(r) & np.isfinite(m), found, np.inf)
