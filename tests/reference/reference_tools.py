"""Tools shared by the reference scenes: piecewise integration, comparison, CSV files.

Independent of the package under test on purpose: only numpy and scipy are imported here.
"""

import json
import pathlib

import numpy as np
from scipy.integrate import solve_ivp

FOLDER = pathlib.Path(__file__).resolve().parent
RTOL = 1e-13  # of the published run
RTOL_CHECK = 1e-12  # of the run it is compared with


def load(name):
    """Return the content of data/<name>.json (parameters and initial values, SI)."""
    return json.loads((FOLDER / "data" / f"{name}.json").read_text())


def grid(*parts):
    """Return the sorted union of (start, stop, step) grids and single times, as decimal-rounded floats."""
    times = set()
    for part in parts:
        if np.isscalar(part):
            times.add(float(part))
        else:
            start, stop, step = part
            count = round((stop - start) / step)
            times.update(round(start + k * step, 9) for k in range(count + 1))
    return np.array(sorted(times))


def integrate(pieces, y0, times, scale, rtol=RTOL, method="DOP853", **options):
    """Return y at `times` (rows) for y' = rhs(t, y), with a fresh start at every entry of `times`.

    pieces: ((t_end, rhs), ...), rhs valid up to t_end; every t_end inside must be one of `times`, so that
    no step crosses a discontinuity and no value comes from the (less accurate) dense output.
    The local error of y_i is held below rtol (|y_i| + scale_i). Raises RuntimeError if a piece fails.
    """
    for t_end, _ in pieces[:-1]:
        if t_end < times[-1] and t_end not in times:
            raise ValueError(f"discontinuity at t = {t_end} is not an output time")
    rows, step = [np.asarray(y0, dtype=float)], None
    for t0, t1 in zip(times[:-1], times[1:], strict=False):
        rhs = next(f for t_end, f in pieces if t1 <= t_end)
        first = None if step is None else min(step, t1 - t0)
        run = solve_ivp(
            rhs,
            (t0, t1),
            rows[-1],
            method=method,
            rtol=rtol,
            atol=rtol * np.asarray(scale, dtype=float),
            first_step=first,
            **options,
        )
        if not run.success:
            raise RuntimeError(f"{method} failed on [{t0}, {t1}]: {run.message}")
        rows.append(run.y[:, -1])
        jump = any(t1 == t_end for t_end, _ in pieces)
        step = None if jump or len(run.t) < 3 else run.t[-2] - run.t[-3]
    return np.array(rows)


def agreement(first, second, groups):
    """Return {group: max|first - second| / scale}; groups = {name: (columns, kind)}.

    kind "relative" divides by the largest magnitude in the group over all rows; "absolute" divides by one.
    """
    result = {}
    for name, (columns, kind) in groups.items():
        a, b = first[:, columns], second[:, columns]
        size = np.max(np.abs(a)) if kind == "relative" else 1.0
        result[name] = float(np.max(np.abs(a - b)) / size)
    return result


def describe(errors, groups):
    """Return `errors` as one readable line, e.g. "currents 1.0e-13 relative, theta 2.0e-12 absolute"."""
    return ", ".join(f"{name} {value:.1e} {groups[name][1]}" for name, value in errors.items())


def write(name, comments, columns, times, values):
    """Write <name>.csv: '#' comment lines, one line of column names, rows in %.17g; return its path."""
    path = FOLDER / f"{name}.csv"
    with path.open("w", newline="\n") as file:
        for line in comments:
            file.write(f"# {line}\n")
        file.write(",".join(["time", *columns]) + "\n")
        np.savetxt(file, np.column_stack([times, values]), fmt="%.17g", delimiter=",")
    return path


def read(name):
    """Return ({column: values}) of <name>.csv."""
    lines = [s for s in (FOLDER / f"{name}.csv").read_text().splitlines() if not s.startswith("#")]
    table = np.array([[float(x) for x in s.split(",")] for s in lines[1:]])
    return dict(zip(lines[0].split(","), table.T, strict=False))


def names(symbol, count):
    """Return [symbol[1], ..., symbol[count]]."""
    return [f"{symbol}[{k + 1}]" for k in range(count)]
