"""A function of arrays with its derivatives, which the doors to other tools take: a run, or a step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ArgumentBlock:
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

    @property
    def name(self) -> str:
        """Name of the model."""
        ...

    @property
    def inputs(self) -> tuple[ArgumentBlock, ...]: ...
    @property
    def outputs(self) -> tuple[ArgumentBlock, ...]: ...
    @property
    def start(self) -> tuple[Array, ...]:
        """Arguments as the model declares them."""
        ...

    def values(self, *arguments: ArrayLike) -> tuple[Array, ...]: ...
    def forward(self, arguments: Sequence[ArrayLike], along: Sequence[ArrayLike]) -> tuple[Array, ...]: ...
    def reverse(self, arguments: Sequence[ArrayLike], bars: Sequence[ArrayLike]) -> tuple[Array, ...]: ...


@dataclass(frozen=True)
class RestrictedFunction:
    """A function of some of the arguments of another one; the rest are what its model declares."""

    of: Differentiable
    places: tuple[int, ...]

    @property
    def name(self) -> str:
        return self.of.name

    @property
    def inputs(self) -> tuple[ArgumentBlock, ...]:
        return tuple(self.of.inputs[i] for i in self.places)

    @property
    def outputs(self) -> tuple[ArgumentBlock, ...]:
        return self.of.outputs

    @property
    def start(self) -> tuple[Array, ...]:
        return tuple(self.of.start[i] for i in self.places)

    def values(self, *arguments: ArrayLike) -> tuple[Array, ...]:
        return self.of.values(*self._all(self.of.start, arguments))

    def forward(self, arguments: Sequence[ArrayLike], along: Sequence[ArrayLike]) -> tuple[Array, ...]:
        nothing = [np.zeros(b.n) for b in self.of.inputs]
        return self.of.forward(self._all(self.of.start, arguments), self._all(nothing, along))

    def reverse(self, arguments: Sequence[ArrayLike], bars: Sequence[ArrayLike]) -> tuple[Array, ...]:
        found = self.of.reverse(self._all(self.of.start, arguments), bars)
        return tuple(found[i] for i in self.places)

    def _all(self, rest: Sequence[ArrayLike], own: Sequence[ArrayLike]) -> list[ArrayLike]:
        found = list(rest)
        for i, v in zip(self.places, own, strict=True):
            found[i] = v
        return found


def restricted(of: Differentiable, free: Sequence[str] | None) -> Differentiable:
    """`of` with the arguments `free` in their order, None for all; KeyError for one that there is not."""
    if free is None:
        return of
    names = [b.name for b in of.inputs]
    if lost := [n for n in free if n not in names]:
        raise KeyError(f"{of.name}: no argument '{lost[0]}'; there are: {', '.join(names)}")
    return RestrictedFunction(of, tuple(names.index(n) for n in free))


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (", .." if len(names) > 4 else "")
