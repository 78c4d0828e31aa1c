"""Functions of CasADi on arrays that stay: a call without conversions."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]


class BufferedFunction:
    """A kernel function mapped over the instances of a group, on arrays of its arguments and results (n x width each)."""

    def __init__(self, function: Any, arg: list[Any], res: list[Any]):
        n = len(arg[0]) if arg else 1
        mapped = function.map(n) if n > 1 else function
        self.arg, self.res = arg, res
        self._keep = mapped.buffer()
        buffer, self.call = self._keep
        for i, a in enumerate(arg):
            if a.size:
                buffer.set_arg(i, memoryview(a))
        for i, r in enumerate(res):
            if r.size:
                buffer.set_res(i, memoryview(r))
