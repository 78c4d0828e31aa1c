"""The derivative of measures of a run by parameters, start values and held inputs.

    max(gen.w) by gen.J:   d(gen.w)/d(gen.J) at the row of the largest value

A measure is one of a sweep: first, last, min, max, peak, mean or rms of a signal, columns of the ledger included
(`last(energy.dissipated)`).  Extremes are those of the rows; where two are as large, the first one counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.sensitive import SensitiveSteps
from phfmu.discretise.model import Model
from phfmu.network.members.columns import Columns
from phfmu.runs.loop import run
from phfmu.runs.options import Options
from phfmu.signals import derivative_name
from phfmu.sweeps.measures import Measure, mean, measures

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gradient:
    """Values of the measures, and their derivatives `slopes` (measures x names)."""

    measures: tuple[str, ...]
    names: tuple[str, ...]
    values: Array
    slopes: Array

    def by(self, measure: str, name: str) -> float:
        """One derivative; ValueError for a measure or name that was not asked for."""
        return float(self.slopes[self.measures.index(measure), self.names.index(name)])


def gradient(
    model: Model, instance: Any, options: Options, of: Sequence[str], by: Sequence[str], inputs: Any = None
) -> Gradient:
    """Derivatives of measures `of` a run (`max(gen.w)`, `rms(*.i)`) by the names `by`.

    options:  of the run, with its events;  inputs: data over time, as of `run`
    Errors: ValueError for measures that are none, or have no derivative (the time of an extreme is that of a row); those of
    `SensitiveSteps`.
    """
    wanted = measures(of, Columns(model, instance.layout).names)
    if times := [m for m in wanted if m.kind not in SLOPES]:
        raise ValueError(f"{times[0]} is the time of a row, which does not move; measures: {', '.join(SLOPES)}")
    signals = list(dict.fromkeys(m.signal for m in wanted))
    stepper = SensitiveSteps(model, instance, by, signals)
    names = stepper.by.names
    found = run(stepper, replace(options, signals=stepper.columns, every=None), inputs=inputs)
    values = np.array([m.of(found.time, found.column(m.signal)) for m in wanted])
    slopes = np.array([[_slope(m, found, n) for n in names] for m in wanted]).reshape(len(wanted), len(names))
    return Gradient(tuple(map(str, wanted)), names, values, slopes)


def _slope(m: Measure, found: Any, name: str) -> float:
    v, d = found.column(m.signal), found.column(derivative_name(m.signal, name))
    return SLOPES[m.kind](found.time, v, d)


def _of_rms(t: Array, v: Array, d: Array) -> float:
    size = np.sqrt(mean(t, v * v))
    return mean(t, v * d) / size if size else 0.0


def _of_peak(_: Array, v: Array, d: Array) -> float:
    i = int(np.abs(v).argmax())
    return float(np.sign(v[i]) * d[i])


#: kind of measure -> its derivative, of times, values and their derivatives
SLOPES: dict[str, Callable[[Array, Array, Array], float]] = {
    "first": lambda t, v, d: float(d[0]),
    "last": lambda t, v, d: float(d[-1]),
    "min": lambda t, v, d: float(d[v.argmin()]),
    "max": lambda t, v, d: float(d[v.argmax()]),
    "peak": _of_peak,
    "mean": lambda t, v, d: mean(t, d),
    "rms": _of_rms,
}
