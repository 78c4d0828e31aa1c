"""Limits as modes: a state that stops at its limits, a value that is clipped, the lesser of two values.

A limit is a mode with state events, so that steps end where it is met and left, and right-hand sides are smooth in between.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from phfmu.declare.event import Guard, StateEvent
from phfmu.declare.variable import Variable, _sx, parameter

#: of the nominal value or rate: how far it has turned inward when a limit is left.  Without it, rounding leads to and fro between
#: opposite guards at one and the same zero: of a value of high gain that turns slowly, of a state that rests at its limit.
BAND = 1e-9


@dataclass(frozen=True, eq=False)
class Limit:
    """A limited expression: `expr` takes its place; `mode` and `events` join those of the declaration."""

    expr: ca.SX
    mode: Variable
    events: tuple[StateEvent, ...]


def limited(
    state: Variable, rate: Any, lo: Any, hi: Any, *, nominal: float = 1.0, unit: str = "1", seconds: float = 1.0
) -> Limit:
    """A limit without wind-up: the state stops at `hi` or `lo` and leaves it as soon as its rate turns inward.

        x' = (1 - m^2) rate,    m = 1 at hi, -1 at lo, 0 between

    The mode is `<state>_at`; the events are `<state>_hits_max`, `<state>_hits_min`, `<state>_leaves_max`,
    `<state>_leaves_min`.  `lo`, `hi`: numbers or expressions of parameters (a limit that moves does not push the
    state), None: not limited there;  `nominal` [unit]: typical magnitude of the state;  `seconds` [s]: its time
    constant, for that of the rate.  It leaves a limit when its rate is 1e-9 of `nominal`/`seconds` inward.
    """
    x, slope, name = state.sx, ca.SX(_sx(rate)), state.name
    m = _mode(f"{name}_at", f"{name}: 1 at its upper limit, -1 at its lower one")
    per, size = f"{unit}/s", nominal / seconds
    above = (
        ()
        if hi is None
        else (
            _event(f"{name}_hits_max", x - _sx(hi), 1, nominal, unit, m, 0.0, 1.0),
            _event(f"{name}_leaves_max", slope + BAND * size, -1, size, per, m, 1.0, 0.0),
        )
    )
    below = (
        ()
        if lo is None
        else (
            _event(f"{name}_hits_min", x - _sx(lo), -1, nominal, unit, m, 0.0, -1.0),
            _event(f"{name}_leaves_min", slope - BAND * size, 1, size, per, m, -1.0, 0.0),
        )
    )
    return Limit(slope * (1 - m.sx**2), m, (*above, *below))


def clipped(name: str, expr: Any, lo: Any, hi: Any, *, nominal: float = 1.0, unit: str = "1") -> Limit:
    """A value between limits: an output that winds up behind it, or a rate limit where the value is a rate.

        y = (1 - m^2) expr + m (m + 1)/2 hi + m (m - 1)/2 lo,    m = 1 above hi, -1 below lo, 0 between

    The mode is `<name>_at`; the events are `<name>_hits_max`, `<name>_hits_min`, `<name>_leaves_max`, `<name>_leaves_min`.
    It leaves a limit 1e-9 of `nominal` inside of it.
    """
    y, low, high = (ca.SX(_sx(e)) for e in (expr, lo, hi))
    m = _mode(f"{name}_at", f"{name}: 1 above its upper limit, -1 below its lower one")
    events = (
        _event(f"{name}_hits_max", y - high, 1, nominal, unit, m, 0.0, 1.0),
        _event(f"{name}_hits_min", y - low, -1, nominal, unit, m, 0.0, -1.0),
        _event(f"{name}_leaves_max", y - high + BAND * nominal, -1, nominal, unit, m, 1.0, 0.0),
        _event(f"{name}_leaves_min", y - low - BAND * nominal, 1, nominal, unit, m, -1.0, 0.0),
    )
    above, below = m.sx * (m.sx + 1) / 2, m.sx * (m.sx - 1) / 2
    return Limit((1 - m.sx**2) * y + above * high + below * low, m, events)


def lesser(name: str, a: Any, b: Any, *, nominal: float = 1.0, unit: str = "1") -> Limit:
    """The lesser of two values, a low value gate: the mode `<name>_second` is 1 while that is `b`."""
    first, second = ca.SX(_sx(a)), ca.SX(_sx(b))
    m = parameter(
        f"{name}_second", 0.0, min=0.0, max=1.0, description=f"{name}: 1 while the second value is the lesser"
    )
    events = (
        _event(f"{name}_to_second", first - second, 1, nominal, unit, m, 0.0, 1.0),
        _event(f"{name}_to_first", first - second + BAND * nominal, -1, nominal, unit, m, 1.0, 0.0),
    )
    return Limit((1 - m.sx) * first + m.sx * second, m, events)


def _mode(name: str, description: str) -> Variable:
    return parameter(name, 0.0, min=-1.0, max=1.0, description=description)


def _event(
    name: str, expr: ca.SX, direction: int, nominal: float, unit: str, mode: Variable, before: float, after: float
) -> StateEvent:
    guard = Guard(name, expr, direction, nominal, unit)
    return StateEvent(guard, when={mode.name: before}, sets={mode.name: after})
