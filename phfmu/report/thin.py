"""Fewer points, the same picture.

Of each column of pixels a line chart shows no more than its first, smallest, largest and last point (M4: Jugel, Jerzak,
Hackenbroich, Markl, VLDB 2014). What lies between them is not drawn by any number of points.
"""

from collections.abc import Sequence

import numpy as np

from phfmu.report.recording import Floats

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
