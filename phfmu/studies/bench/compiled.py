"""Right-hand sides for peers in machine code, so that a comparison does not measure an interpreter."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def compiled(f: ca.Function, jacobians: bool = False) -> ca.Function:
    """`f` compiled with the project's flags and loaded as an external; `f` itself without a C compiler.

    jacobians: with its derivatives, for solvers that ask the function for them.
    """
    from phfmu.engine.build.compile import CompilerMissing, compile

    generator = ca.CodeGenerator(f"{f.name()}.c", {"with_header": False})
    generator.add(f)
    if jacobians:
        generator.add(f.forward(1))
        generator.add(f.reverse(1))
        generator.add(f.jacobian())
    try:
        # symbols must stay visible for the loader
        path: Path = compile({f"{f.name()}.c": generator.dump()}, flags=("-fvisibility=default",)).path
    except CompilerMissing:
        return f
    return ca.external(f.name(), str(path))


class Buffered:
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
