"""Signals that swing too fast for a picture of the whole run: the band they fill, and a window in which they can be read."""

import numpy as np

from phfmu.report.recording import Floats

#: parts of the time in which swings are counted; a part with this many swings up or down of its own height is a black bar
PARTS, SWINGS = 100, 2.0
#: parts of a band; periods shown in the window, and those of them before an event
BAND, PERIODS, BEFORE = 400, 4.0, 1.5
#: least height of a part that counts, of the height of the whole
_FLAT = 0.04


def swings(values: Floats, reach: float = 0.0) -> float:
    """Swings up or down in a hundredth of the rows, the median of the parts that move.

    0.0 for slow, short or flat ones; `reach`: largest magnitude on the axis, to which rounding errors are flat.
    """
    finite = values[np.isfinite(values)]
    if len(finite) < 4 * PARTS:
        return 0.0
    height = float(np.ptp(finite))
    if height <= 1e-6 * max(reach, float(np.abs(finite).max())):
        return 0.0
    found = []
    for part in np.array_split(finite, PARTS):
        size = float(np.ptp(part))
        if size > _FLAT * height:
            found.append(float(np.abs(np.diff(part)).sum()) / size)
    median = float(np.median(found)) if len(found) >= PARTS // 4 else 0.0
    return median if median >= SWINGS else 0.0


def band(time: Floats, values: Floats, counted: float = 0.0) -> tuple[Floats, Floats, Floats]:
    """Times, smallest and largest value of each part of the time that holds a row.

    `BAND` parts, fewer where a whole period of a signal with `counted` swings in a part would not fit.
    """
    parts = min(BAND, int(PARTS * counted / 2.4)) if counted else BAND
    edges = np.linspace(time[0], time[-1], parts + 1)
    starts = np.searchsorted(time, edges[:-1])
    full = np.append(starts[1:], len(time)) > starts
    at = starts[full]
    low = np.fmin.reduceat(values, at)
    return (0.5 * (edges[:-1] + edges[1:]))[full], low, np.fmax.reduceat(values, at)


def window(time: Floats, counted: float, events: list[float]) -> tuple[float, float]:
    """A few periods of a signal with `counted` swings in a part: about the first event, else the last ones."""
    first, last = float(time[0]), float(time[-1])
    period = 2.0 * (last - first) / PARTS / counted
    inside = [t for t in events if first < t < last - PERIODS * period]
    start = max(inside[0] - BEFORE * period, first) if inside else last - PERIODS * period
    return start, start + PERIODS * period
