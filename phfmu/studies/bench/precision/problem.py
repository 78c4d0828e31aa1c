"""Problems and their measures: one declaration, its events, times, a reference and error measures."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.phdae import PHDAE
from phfmu.network.scene import Event, Scene
from phfmu.studies.bench.precision.reduced import ReducedSystem, live_values, reduced

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EventFreeInterval:
    """An interval without events: [start, end], values that change at its start, and the times asked for inside."""

    start: float
    end: float
    changes: dict[str, float]
    times: Array

    @property
    def stops(self) -> Array:
        """The times asked for and the end."""
        return self.times if len(self.times) and self.times[-1] == self.end else np.append(self.times, self.end)


@dataclass(frozen=True)
class SolutionErrors:
    """Errors of one solution: relative state error per time; energy error [J] and constraint drift at the worst time."""

    errors: tuple[float, ...]
    energy: float
    drift: float


class WorkPrecisionProblem(Protocol):
    """A problem whose solutions are compared: `grid` holds the times of comparison and the stop time [s], `judged` names the
    variables in the errors."""

    @property
    def name(self) -> str: ...
    @property
    def times(self) -> tuple[float, ...]: ...
    @property
    def stop(self) -> float: ...
    @property
    def judged(self) -> tuple[str, ...]: ...
    @property
    def grid(self) -> Array: ...
    def judge(self, x: Array) -> SolutionErrors: ...


@dataclass(eq=False)
class InitialValueProblem:
    """A declaration with the times [s] of comparison and the stop time of the timing runs.

    judged: names of the state variables in the error norm;  gamma: stabilisation of the reduced system [1/s]
    reference: states (times + stop) x n1, filled by `solve_reference` or `read_reference`; `uncertainty`: its own error.
    """

    name: str
    declaration: PHDAE
    events: tuple[Event, ...]
    times: tuple[float, ...]
    stop: float
    step: float
    judged: tuple[str, ...] = ()
    gamma: float = 20.0
    reference: Array = field(default_factory=lambda: np.zeros((0, 0)))
    reference_name: str = ""
    uncertainty: float = float("nan")

    def __post_init__(self) -> None:
        known = [v.name for v in self.declaration.states]
        for name in self.judged:
            if name not in known:
                raise ValueError(f"{self.name} has no state variable '{name}'; it has: {', '.join(known)}")
        for t in self.times:
            if not 0 < t <= self.stop:
                raise ValueError(f"--times {t:g}: expected a time after 0 and up to the stop time {self.stop:g} s")

    @property
    def grid(self) -> Array:
        """Times of comparison and the stop time."""
        return np.array(sorted({*self.times, self.stop}))

    @cached_property
    def system(self) -> ReducedSystem:
        return reduced(self.declaration, gamma=self.gamma, live={e.name for e in self.events})

    def pieces(self, times: Sequence[float] | Array) -> Iterator[EventFreeInterval]:
        """Intervals between events up to the last of `times`."""
        last = float(max(times))
        marks = sorted({0.0, last, *(e.t for e in self.events if 0 < e.t < last)})
        for start, end in zip(marks[:-1], marks[1:], strict=True):
            here = [e for e in self.events if (e.t <= start if start == 0 else e.t == start)]
            inside = np.array([t for t in times if start < t <= end])
            yield EventFreeInterval(start, end, {e.name: e.value for e in here}, inside)

    def live(self, changes: dict[str, float], before: Array) -> Array:
        """Live values of the reduced system after the changes of a piece."""
        return live_values(self.system, before, changes)

    def require_step(self, h: float) -> None:
        """RuntimeError if a time of comparison or the stop time is no multiple of a fixed step h [s]."""
        for t in self.grid:
            if abs(t / h - round(t / h)) > 1e-9:
                raise RuntimeError(f"t = {t:g} s is no multiple of the step")

    # -- judging ----------------------------------------------------------------------------------------------------

    @cached_property
    def _groups(self) -> list[list[int]]:
        groups, first = [], 0
        for v in self.declaration.states:
            if not self.judged or v.name in self.judged:
                groups.append(list(range(first, first + v.n)))
            first += v.n
        return groups

    @cached_property
    def _probe(self) -> ca.Function:
        s = self.system
        out = [s.H, s.checks]
        if s.live.numel():
            out = ca.substitute(out, [s.live], [ca.SX(s.live_start)])
        return ca.Function("probe", [s.t, s.x], out)

    def distance(self, x: Array, exact: Array) -> float:
        """Largest relative 2-norm over the judged variables (their largest norm over all times where one is near zero)."""
        worst = 0.0
        for g in self._groups:
            largest = max(np.linalg.norm(self.reference[:, g], axis=1).max(initial=0.0), 1e-300)
            norm = float(np.linalg.norm(exact[g]))
            worst = max(worst, float(np.linalg.norm(x[g] - exact[g])) / (norm if norm > 1e-3 * largest else largest))
        return worst

    def judge(self, x: Array) -> SolutionErrors:
        """`x`: states at `grid`."""
        grid = list(self.grid)
        errors = tuple(self.distance(x[grid.index(t)], self.reference[grid.index(t)]) for t in self.times)
        energy, drift = 0.0, 0.0
        for i, t in enumerate(grid):
            H, checks = self._probe(t, x[i])
            exact = float(self._probe(t, self.reference[i])[0])
            energy = max(energy, abs(float(H) - exact))
            drift = max(drift, float(np.abs(np.array(checks)).max(initial=0.0)))
        return SolutionErrors(errors, energy, drift)

    def read_reference(self, path: str) -> None:
        """States at the times from a CSV: column `time`, a column per scalar state; ValueError names what is missing."""
        with Path(path).open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(line for line in file if not line.startswith("#")))
        names, values = rows[0], np.array([[float(x) for x in r] for r in rows[1:]])
        wanted = [n for v in self.declaration.states for n in v.names()]
        if missing := [n for n in ("time", *wanted) if n not in names]:
            raise ValueError(
                f"--reference {path}: no column {', '.join(missing[:5])}; it has: {', '.join(names[:8])} ..."
            )
        have = values[:, names.index("time")]
        at = [int(np.argmin(np.abs(have - t))) for t in self.grid]
        for t, i in zip(self.grid, at, strict=True):
            if abs(have[i] - t) > 1e-9 * max(1.0, t):
                raise ValueError(f"--reference {path}: no row at t = {t:g} s (nearest: {have[i]:g} s)")
        self.reference = values[np.ix_(at, [names.index(n) for n in wanted])]
        self.reference_name = path


def problem_of(
    scene: Scene,
    *,
    times: Sequence[float] = (),
    stop: float | None = None,
    judged: Sequence[str] = (),
    gamma: float = 20.0,
) -> InitialValueProblem:
    """A scene as a problem; default times: a tenth of the run and its end."""
    end = scene.stop if stop is None else stop
    chosen = tuple(times) or (end / 10, end)
    return InitialValueProblem(
        scene.name, scene.declaration(), scene.events, chosen, end, scene.step, tuple(judged), gamma
    )
