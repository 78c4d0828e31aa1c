"""Words of sweeps and of their measures."""

#: an axis
FORMS = "NAME=FROM:TO:COUNT, NAME=log:FROM:TO:COUNT or NAME=A,B,.."

#: kind of measure -> what it is; the order is that of runtime/runs.c
KINDS = {
    "first": "value at the start",
    "last": "value at the end",
    "min": "least value",
    "max": "greatest value",
    "peak": "greatest magnitude",
    "mean": "mean over time, by the trapezoidal rule",
    "rms": "root of the mean square over time",
    "tmin": "time of the least value, of the first of several (s)",
    "tmax": "time of the greatest value, of the first of several (s)",
}
