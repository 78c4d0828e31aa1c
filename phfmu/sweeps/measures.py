"""Measures of a run: one number from all values of a signal, at the start and at the end of each step."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phfmu.sweeps.words import KINDS
from phfmu.words import meant

Floats = NDArray[np.float64]


def mean(t: Floats, v: Floats) -> float:
    """Over time, by the trapezoidal rule."""
    return float(np.trapezoid(v, t) / (t[-1] - t[0]))


#: kind -> the number that it makes of times and values
NUMBERS: dict[str, Callable[[Floats, Floats], float]] = {
    "first": lambda t, v: float(v[0]),
    "last": lambda t, v: float(v[-1]),
    "min": lambda t, v: float(v.min()),
    "max": lambda t, v: float(v.max()),
    "peak": lambda t, v: float(np.abs(v).max()),
    "mean": mean,
    "rms": lambda t, v: float(np.sqrt(mean(t, v * v))),
    "tmin": lambda t, v: float(t[v.argmin()]),
    "tmax": lambda t, v: float(t[v.argmax()]),
}


@dataclass(frozen=True)
class Measure:
    """`kind` (of KINDS) of `signal`."""

    kind: str
    signal: str

    def __str__(self) -> str:
        return f"{self.kind}({self.signal})"

    def of(self, t: Floats, values: Floats) -> float:
        """The number for a run of which all rows are known."""
        return NUMBERS[self.kind](t, values)


def measures(texts: Sequence[str], signals: Sequence[str]) -> list[Measure]:
    """`max(gen.w)`, `mean(*.energy.stored)`, ..: a pattern gives one for each signal it means.

    Errors: ValueError for another form, an unknown kind, or a pattern that means no signal.
    """
    from phfmu.pick import pick

    found: dict[Measure, None] = {}
    for text in texts:
        form = re.fullmatch(r"\s*(\w+)\((.+)\)\s*", text)
        if form is None:
            raise ValueError(f"--measure {text}: expected KIND(SIGNAL), e.g. max(gen.w); kinds: {', '.join(KINDS)}")
        if form[1] not in KINDS:
            raise ValueError(
                f"--measure {text}: no kind '{form[1]}'; {meant(form[1], list(KINDS), 'kinds: ' + ', '.join(KINDS))}"
            )
        for signal in pick([form[2].strip()], signals, "the model"):
            found[Measure(form[1], signal)] = None
    return list(found)
