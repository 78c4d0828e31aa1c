"""Timing and interpolation shared by the scripts of this folder."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from phfmu import PHDAE
from phfmu.discretise.model import build_model, default_scheme
from phfmu.engine.native.native import NativeInstance


def rounds(jobs: Mapping[str, Callable[[], object]], repeats: int) -> list[dict[str, float]]:
    """Process CPU time [s] of every job; all jobs are run in turn, `repeats` times.

    A ratio is taken in each round, which is short beside the changes of a shared machine's speed.
    """
    found = []
    for _ in range(repeats):
        spent = {}
        for name, job in jobs.items():
            start = time.process_time()
            job()
            spent[name] = time.process_time() - start
        found.append(spent)
    return found


def medians(found: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Median over all rounds."""
    return {name: statistics.median(spent[name] for spent in found) for name in found[0]}


def quartiles(values: Sequence[float]) -> str:
    """Median and quartiles."""
    low, middle, high = statistics.quantiles(values, n=4)
    return f"{middle:.2f} (half of the rounds between {low:.2f} and {high:.2f})"


def at_error(points: Sequence[tuple[float, float]], error: float) -> float:
    """Cost at an error, from (error, cost) points, on the line through the neighbours in both logarithms."""
    points = sorted(points)
    for (e0, c0), (e1, c1) in zip(points, points[1:], strict=False):
        if e0 <= error <= e1:
            s = math.log(error / e0) / math.log(e1 / e0)
            return c0 * (c1 / c0) ** s
    return points[-1][1] if error > points[-1][0] else math.nan


def relative(q: np.ndarray, exact: np.ndarray) -> float:
    """Relative 2-norm of the error."""
    return float(np.linalg.norm(q - exact) / np.linalg.norm(exact))


class Run:
    """The native engine on one model, order and step size."""

    def __init__(self, declaration: PHDAE, order: int, h: float):
        self.instance = NativeInstance(build_model(declaration, default_scheme(declaration, order)))
        self.h, self.nq = h, declaration.states[0].n

    def positions(self, stop: float) -> np.ndarray:
        """q after `stop` seconds in steps as long as h or a little shorter."""
        n = math.ceil(stop / self.h - 1e-9)
        self.instance.reset()
        self.instance.run(0.0, stop / n, n)
        return self.instance.x[: self.nq]

    def job(self, stop: float) -> Callable[[], object]:
        n = round(stop / self.h)

        def steps() -> None:
            self.instance.reset()
            self.instance.run(0.0, self.h, n)

        return steps
