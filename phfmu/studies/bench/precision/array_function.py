"""Compiled functions of CasADi called without conversions, so that a comparison does not measure these."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.engine.build.machine_code import compiled

Array = NDArray[np.float64]


class ArrayFunction:
    """A function of flat arrays on buffers that stay: arguments are copied in, the first result is a fresh array."""

    def __init__(self, f: ca.Function):
        self._buffer, self._call = f.buffer()
        self._args = [np.zeros(f.nnz_in(i)) for i in range(f.n_in())]
        self._out = [np.zeros(f.nnz_out(i)) for i in range(f.n_out())]
        for i, a in enumerate(self._args):
            self._buffer.set_arg(i, memoryview(a))  # type: ignore
        for i, a in enumerate(self._out):
            self._buffer.set_res(i, memoryview(a))  # type: ignore

    def __call__(self, *values: Array | float) -> Array:
        for a, v in zip(self._args, values, strict=False):
            a[:] = v
        self._call()
        return self._out[0].copy()


def compiled_expression(name: str, arguments: Sequence[ca.SX], expression: ca.SX) -> ArrayFunction:
    """An expression in machine code; the result is dense, of a matrix by columns."""
    return ArrayFunction(compiled(ca.Function(name, [*arguments], [ca.densify(expression)])))
