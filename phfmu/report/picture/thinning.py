"""Signals that swing too fast for a picture of the whole run: the band they fill, and a window in which they can be read.

Fewer points, the same picture.

Of each column of pixels a line chart shows no more than its first, smallest, largest and last point (M4: Jugel, Jerzak,
Hackenbroich, Markl, VLDB 2014). What lies between them is not drawn by any number of points.
"""

from collections.abc import Sequence

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


#: columns of pixels that a curve is thinned to, and points in each
COLUMNS, PER_COLUMN = 1500, 4


#: passes that leave out points of a line, each of which moves it by this part of the height of its axis at the most
PASSES, MOVED = 12, 1e-4


def lean(time: Floats, values: Floats, size: float) -> tuple[Floats, Floats]:
    """A curve without the points that lie on the line between their neighbours, to `PASSES` `MOVED` of `size`.

    time, values [n]; ends, and what stands beside a gap, stay.
    """
    for _ in range(PASSES):
        if len(time) < 3:
            break
        t, v = time[1:-1], values[1:-1]
        before, after = time[:-2], time[2:]
        span = np.where(after > before, after - before, 1.0)
        line = values[:-2] + (values[2:] - values[:-2]) * ((t - before) / span)
        straight = (np.abs(v - line) <= MOVED * size) & (after > before)
        kept = np.append(np.insert(~straight, 0, True), True)
        kept[::2] = True  # no two neighbours at once: each is measured by points that stay
        if kept.all():
            break
        time, values = time[kept], values[kept]
    return time, values


def columns_within(sizes: Sequence[int], points: int) -> int:
    """Columns to which curves of these sizes are thinned so that all together have at most so many points."""
    low, high = 1, max([COLUMNS, *sizes])
    while low < high:
        middle = (low + high + 1) // 2
        fits = sum(min(n, PER_COLUMN * middle) for n in sizes) <= points
        low, high = (middle, high) if fits else (low, middle - 1)
    return low


def thin(time: Floats, values: Floats, columns: int = COLUMNS) -> tuple[Floats, Floats]:
    """Points of a curve: first, smallest, largest and last of each of `columns` equal parts of the time.

    time, values [n], time not falling; NaN are gaps and stay where a part holds nothing else. n <= 4 columns: as it is.
    """
    n = len(time)
    if n <= PER_COLUMN * columns:
        return time, values
    edges = np.searchsorted(time, np.linspace(time[0], time[-1], columns + 1)[1:-1])
    starts = np.unique(np.concatenate([[0], edges[edges < n]]))
    ends = np.append(starts[1:], n)
    low, high = np.where(np.isnan(values), np.inf, values), np.where(np.isnan(values), -np.inf, values)
    at = [
        i
        for a, b in zip(starts.tolist(), ends.tolist(), strict=True)
        for i in (a, a + int(low[a:b].argmin()), a + int(high[a:b].argmax()), b - 1)
    ]
    kept = np.unique(at)
    return time[kept], values[kept]
