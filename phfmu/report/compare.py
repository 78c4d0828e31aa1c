"""Two tables or audits signal by signal: by how much they differ, and where most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.report.recording import Recording, Signal

#: times that differ by less, relative to the larger one or to 1 s, are one
CLOSE = 1e-9


@dataclass(frozen=True)
class SignalDifference:
    """The largest |a - b| of a signal, its time in s, the values there, and the magnitude it is measured by:
    that of the signal over both runs, see `compare`."""

    name: str
    size: float
    time: float
    a: float
    b: float
    scale: float
    unit: str | None = None

    @property
    def relative(self) -> float:
        """size / scale; 0 of equal signals, infinite where one is not a number."""
        if self.size == 0.0:
            return 0.0
        return self.size / self.scale if self.scale > 0 and np.isfinite(self.size) else np.inf

    def within(self, rtol: float, atol: float) -> bool:
        """|a - b| <= atol + rtol scale."""
        return bool(self.size <= atol + rtol * self.scale)


@dataclass(frozen=True)
class Comparison:
    """Differences, largest relative one first; signals that only one of both has; what was done to compare, a line each."""

    differences: list[SignalDifference]
    only_a: list[str]
    only_b: list[str]
    notes: list[str]


def compare(a: Recording, b: Recording, names: Sequence[str] | None = None) -> Comparison:
    """Differences of the signals that both have (or of `names`), at the times that both have.

    Energies are measured by the largest of all energies compared, since a residual or a sum that cancels is what rounding leaves
    of them.  What hidden constraints miss is compared if it is named.

    Where times differ, the signal with more rows is taken at the times of the other, linearly between its rows, which is said.
    Errors: ValueError for nothing in common.
    """
    kinds = {**b.kinds, **a.kinds}
    wanted = [n for n in common(a, b) if kinds.get(n) != "constraint"] if names is None else list(names)
    if not wanted:
        raise ValueError(f"{a.title} and {b.title} have no signal in common")
    found, between = [], False
    for one, other in zip(a.read(wanted), b.read(wanted), strict=True):
        t, x, y, guessed = _together(one, other)
        if not len(t):
            raise ValueError(f"{a.title} and {b.title} have no times in common")
        between |= guessed
        found.append(_difference(one, t, x, y))
    energies = {n for n, kind in kinds.items() if kind == "energy"}
    most = max((d.scale for d in found if d.name in energies), default=0.0)
    found = [replace(d, scale=most) if d.name in energies else d for d in found]
    notes = [
        "their times differ: compared at those of the shorter table, linearly between rows of the longer one"
    ] * between
    only_a, only_b = ([n for n in p.names if n not in set(q.names)] for p, q in ((a, b), (b, a)))
    return Comparison(sorted(found, key=lambda d: -d.relative), only_a, only_b, notes)


def common(a: Recording, b: Recording) -> list[str]:
    """Signals that both have."""
    return [n for n in a.names if n in set(b.names)]


def _difference(signal: Signal, t: NDArray[Any], x: NDArray[Any], y: NDArray[Any]) -> SignalDifference:
    with np.errstate(invalid="ignore"):
        size = np.where((x == y) | (np.isnan(x) & np.isnan(y)), 0.0, np.abs(x - y))
    size = np.where(np.isnan(size), np.inf, size)
    at = int(np.argmax(size))
    finite = np.concatenate([x[np.isfinite(x)], y[np.isfinite(y)]])
    scale = float(np.abs(finite).max(initial=0.0))
    return SignalDifference(signal.name, float(size[at]), float(t[at]), float(x[at]), float(y[at]), scale, signal.unit)


def _together(a: Signal, b: Signal) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], bool]:
    """Times, values of both there, and whether some were taken between rows."""
    (s, x), (t, y) = ((_last_rows(v)) for v in (a, b))
    if len(s) == len(t) and _near(s, t).all():
        return s, x, y, False
    if len(s) > len(t):
        times, values, guessed = _at(t, s, x)
        return times, values, y[np.isin(t, times)], guessed
    times, values, guessed = _at(s, t, y)
    return times, x[np.isin(s, times)], values, guessed


def _last_rows(signal: Signal) -> tuple[NDArray[Any], NDArray[Any]]:
    """The last one of rows at one time."""
    t = np.asarray(signal.time, float)
    last = np.append(t[1:] > t[:-1], True)
    return t[last], np.asarray(signal.values, float)[last]


def _at(wanted: NDArray[Any], t: NDArray[Any], v: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], bool]:
    """The wanted times within t, v there, and whether some are between rows."""
    inside = wanted[(wanted >= t[0] - CLOSE * (1 + abs(t[0]))) & (wanted <= t[-1] + CLOSE * (1 + abs(t[-1])))]
    near = np.clip(np.searchsorted(t, inside), 1, len(t) - 1) if len(t) > 1 else np.zeros(len(inside), int)
    near = near - (np.abs(t[near - 1] - inside) < np.abs(t[near] - inside)) if len(t) > 1 else near
    known = _near(t[near], inside)
    return inside, np.where(known, v[near], np.interp(inside, t, v)), bool((~known).any())


def _near(s: NDArray[Any], t: NDArray[Any]) -> NDArray[Any]:
    return np.abs(s - t) <= CLOSE * np.maximum(1.0, np.abs(s))
