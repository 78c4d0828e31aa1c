"""Functions of CasADi for peers, called without allocation, so that a comparison does not measure conversions."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class BufferedFunction:
    """A function of flat arrays without allocation per call: arguments are copied in, the result is a fresh array."""

    def __init__(self, f: ca.Function, output: int = 0):
        self._buffer, self._call = f.buffer()
        self._args = [np.zeros(f.nnz_in(i)) for i in range(f.n_in())]
        self._out = [np.zeros(f.nnz_out(i)) for i in range(f.n_out())]
        for i, a in enumerate(self._args):
            self._buffer.set_arg(i, memoryview(a))  # type: ignore
        for i, a in enumerate(self._out):
            self._buffer.set_res(i, memoryview(a))  # type: ignore
        self._output = output

    def __call__(self, *values: Array | float) -> Array:
        for a, v in zip(self._args, values, strict=False):
            a[:] = v
        self._call()
        return self._out[self._output].copy()
