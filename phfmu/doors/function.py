"""A function of arrays with its derivatives, which the doors to other tools take: a run, or a step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Block:
    """An argument or result: its name, and a name for each entry."""

    name: str
    names: tuple[str, ...]

    @property
    def n(self) -> int:
        return len(self.names)

    def of(self, values: ArrayLike) -> Array:
        """Values (n) as an array of its own; ValueError for another length or for values that are not finite."""
        found = np.array(values, float).reshape(-1)
        if len(found) != self.n:
            raise ValueError(f"{self.name}: {len(found)} values given, expected {self.n} ({_few(self.names)})")
        if lost := [n for n, v in zip(self.names, found.tolist(), strict=True) if not np.isfinite(v)]:
            raise ValueError(f"{self.name}: {_few(lost)} must be finite")
        return found


class Differentiable(Protocol):
    """y = f(a) of blocks a to blocks y, with dy = J da (forward) and bar a = J^T bar y (reverse).

    Errors of all: StepFailure where a step cannot be solved; NoDerivative, with its time.
    """

    name: str

    @property
    def inputs(self) -> tuple[Block, ...]: ...
    @property
    def outputs(self) -> tuple[Block, ...]: ...
    @property
    def start(self) -> tuple[Array, ...]:
        """Arguments as the model declares them."""
        ...

    def values(self, *arguments: ArrayLike) -> tuple[Array, ...]: ...
    def forward(self, arguments: Sequence[ArrayLike], along: Sequence[ArrayLike]) -> tuple[Array, ...]: ...
    def reverse(self, arguments: Sequence[ArrayLike], bars: Sequence[ArrayLike]) -> tuple[Array, ...]: ...


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (", .." if len(names) > 4 else "")
