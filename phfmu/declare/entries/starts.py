"""The rule on start values, without which nothing can be computed."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

import numpy as np

from phfmu.declare.error import Problem
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import Variable


def variables(model: PHDAE) -> Iterator[tuple[Variable, str]]:
    """Every variable with the list it stands in."""
    for entry in ("states", "algebraics", "parameters"):
        for v in getattr(model, entry):
            yield v, entry


def starts(model: PHDAE) -> list[Problem]:
    """Start values are finite and as many as the variable has entries."""
    found = []
    for v, entry in variables(model):
        what = "value" if entry == "parameters" else "start"
        if not _sound(v.start, v.n):
            found += _start(f"variable '{v.name}'", what, v.start, v.n, v.names())
        if len(v.nominal) != v.n:
            found.append(_count(f"variable '{v.name}'", "nominal", len(v.nominal), v.n))
    for port in model.ports:
        found += _start(f"port '{port.name}'", "start", _spread(port.start, port), port.n, port.input_names())
        if _spread(port.nominal, port).size != port.n:
            found.append(_count(f"port '{port.name}'", "nominal", np.size(port.nominal), port.n))
    return found


def _spread(value: object, port: Port) -> np.ndarray:
    array = np.asarray(value, float).ravel()
    return np.full(port.n, array[0]) if array.size == 1 else array


def _count(entry: str, what: str, found: int, expected: int) -> Problem:
    return Problem(
        "shape", entry, f"{what} has {found} entries, expected {expected}", "give one number or one per entry"
    )


def _sound(value: object, n: int) -> bool:
    """n finite numbers in a tuple, as a variable that was made by `state` and its like has them."""
    return isinstance(value, tuple) and len(value) == n and all(isinstance(x, float) and isfinite(x) for x in value)


def _start(entry: str, what: str, value, n: int, scalar: list[str]) -> list[Problem]:
    array = np.asarray(value, float).ravel()
    if array.size != n:
        return [_count(entry, what, array.size, n)]
    bad = np.flatnonzero(~np.isfinite(array))
    if not bad.size:
        return []
    return [Problem("start", entry, f"the {what} of {scalar[bad[0]]} is {array[bad[0]]}", "give a finite number")]
