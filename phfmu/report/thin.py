"""Fewer points, the same picture.

Of each column of pixels a line chart shows no more than its first, smallest, largest and last point (M4: Jugel, Jerzak,
Hackenbroich, Markl, VLDB 2014). What lies between them is not drawn by any number of points.
"""

import numpy as np

from phfmu.report.recording import Floats

#: columns of pixels that a curve is thinned to, and points in each
COLUMNS, PER_COLUMN = 1500, 4


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
