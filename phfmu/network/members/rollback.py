"""Whether a unit can take steps back, tried before a run; and how it answers to its inputs, for one that cannot.

Flags of units are wrong in the wild: a saved state may hold less than what the next step depends on.  So steps are taken, taken
back and taken again, in instances of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.reader import FMUInstance
from phfmu.fmu.refusal import UnitCallError

Array = NDArray[np.float64]

STEPS = 2  # are taken again
MOVE = 1e-3  # of an input, relative to itself and its nominal value
REPEATS = 1e-9  # values that differ by less, relative to the largest of the variable, are taken again well enough


@dataclass(frozen=True)
class Rollback:
    """`works`: the couplings that repeat steps may do so; `words`: what is wrong, or not as it should be; else empty."""

    works: bool
    words: str = ""


def try_rollback(make: Callable[[], FMUInstance], h: float) -> Rollback:
    """Save, step, restore, step under other inputs, restore, step: the first and the last must agree bit for bit."""
    with make() as unit:
        if not unit.interface.saves:
            return Rollback(False, "cannot save its state")
        u, names = unit.start_inputs(), [n for n in unit.names if unit.variable(n).causality != "input"]
        t = unit.time

        def after(inputs: Array) -> Array:
            unit.set_input(inputs)
            for k in range(1, 1 + STEPS):
                unit.do_step(t + k * h, h)
            return np.concatenate([unit.get(names), unit.output()])

        unit.do_step(t, h)
        moved, first, again = _moved(unit, u), np.zeros(0), np.zeros(0)
        try:
            state = unit.get_state()
            first = after(moved)
            for inputs in (u, moved):
                unit.set_state(state)
                again = after(inputs)
        except UnitCallError as error:
            return Rollback(False, f"does not restore its state: {error}")
        return _judged([*names, *(f"mean of {n}" for n in unit.outputs)], first, again)


def unsteady(unit: FMUInstance, h: float) -> str:
    """What differs when a step of length h is taken twice from here, in words; "" if nothing does, or not much.

    The unit is back afterwards, as far as it can.
    """
    state, t = unit.get_state(), unit.time
    names = [n for n in unit.names if unit.variable(n).causality != "input"]
    found = []
    for _ in range(2):
        unit.set_state(state)
        unit.do_step(t, h)
        found.append(np.concatenate([unit.get(names), unit.output()]))
    unit.set_state(state)
    judged = _judged([*names, *(f"mean of {n}" for n in unit.outputs)], *found)
    return "" if judged.works else judged.words


def _judged(names: list[str], first: Array, again: Array) -> Rollback:
    if np.array_equal(first, again, equal_nan=True):
        return Rollback(True)
    change = np.abs(again - first) / np.maximum(np.maximum(np.abs(first), np.abs(again)), np.finfo(float).tiny)
    i = int(np.argmax(np.nan_to_num(change, nan=np.inf)))
    if change[i] <= REPEATS:
        return Rollback(True, f"restores its state to a relative {change[i]:.1g} only (worst: {names[i]})")
    told = f"a step repeated from a restored state ends with {names[i]} = {again[i]:.6g}, not {first[i]:.6g}"
    return Rollback(False, f"does not restore its state: {told}")


def response(make: Callable[[], FMUInstance], h: float) -> tuple[Array, Array]:
    """Of the first step: mean outputs (nu) and their derivatives by the held inputs (nu x nu), by an instance for each."""

    def means(j: int | None) -> tuple[Array, float]:
        with make() as unit:
            u, move = unit.start_inputs(), 0.0
            if j is not None:
                move = _moved(unit, u)[j] - u[j]
                u[j] += move
            unit.set_input(u)
            unit.do_step(unit.time, h)
            return unit.output().copy(), move

    base, _ = means(None)
    G = np.zeros((len(base), len(base)))
    for j in range(len(base)):
        y, move = means(j)
        G[:, j] = (y - base) / move
    return base, G


def _moved(unit: FMUInstance, u: Array) -> Array:
    nominal = np.abs(unit.input_sign) * np.array([unit.variable(n).nominal for n in unit.inputs])
    return u + MOVE * (np.abs(u) + nominal)
