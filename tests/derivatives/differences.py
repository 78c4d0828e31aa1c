"""Derivatives of runs by central differences of whole runs, extrapolated from three steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from phfmu import NativeInstance, Options, build_model, default_scheme, run
from phfmu.derivatives.sensitive import SensitiveSteps
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.runs.result import Result
from phfmu.signals import derivative_name


def richardson(values: Callable[[float], np.ndarray], at: float, step: float) -> np.ndarray:
    table: list[list[np.ndarray]] = []
    for level in range(3):
        e = step / 2**level
        row = [(values(at + e) - values(at - e)) / (2 * e)]
        for j in range(level):
            row.append(row[j] + (row[j] - table[level - 1][j]) / (4 ** (j + 1) - 1))
        table.append(row)
    return table[-1][-1]


def largest(result: Result) -> dict[str, float]:
    """The largest size of a value of a run in each unit of measurement."""
    found = dict[str, float]()
    for unit, column in zip(result.units, result.values.T, strict=True):
        found[unit] = max(found.get(unit, 0.0), float(np.abs(column).max()))
    return found


def worst(
    declaration: Any, by: Sequence[str], options: Options, order: int, engine: Any = NativeInstance, part: float = 1e-3
) -> dict[tuple[str, str], float]:
    """(signal, name) -> error of the derivative column, of the largest of its kind that differences resolve."""
    model = build_model(declaration, default_scheme(declaration, order))
    known = {
        n: x for v in (*declaration.parameters, *declaration.states) for n, x in zip(v.names(), v.start, strict=True)
    }
    inputs = [n for p in declaration.ports if p.external for n in p.input_names()]
    held = dict(zip(inputs, model.u0.tolist(), strict=True))
    stepper = SensitiveSteps(model, engine(model), by)
    found, errors = run(stepper, options), {}
    plain = run(Monolithic(model, engine(model)), options)
    size_of = largest(plain)
    for name in stepper.by.names:
        base = (known | held)[name]

        def values(x: float, name: str = name) -> np.ndarray:
            if name in known:
                m = build_model(declaration.with_starts({name: x}), default_scheme(declaration, order))
                return run(Monolithic(m, engine(m)), options).values
            other = Monolithic(model, engine(model))
            other.set_value(name, x)
            return run(other, options).values

        slopes = richardson(values, base, part * (abs(base) or 1.0))
        for q in stepper.derived:
            if q.name.startswith("constraint.") or q.name.endswith((".residual", ".gap")):
                continue  # rounding
            i = plain.names.index(q.name)
            size = size_of[plain.units[i]] / (abs(base) or 1.0)
            own = found.column(derivative_name(q.name, name))
            errors[q.name, name] = float(
                np.abs(own - slopes[:, i]).max() / max(np.abs(slopes[:, i]).max(), 1e-4 * size, 1e-12)
            )
    return errors
