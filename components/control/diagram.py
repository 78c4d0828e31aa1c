"""Block diagrams of controllers as they are drawn: lags, lead-lags, washouts and limits make a declaration.

Every block is given its input as an expression and gives its output as one.  Time constants and gains are parameters;
a block whose time constants are 0 is not there, as is customary in data of power systems.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from phfmu import (
    PHDAE,
    Limit,
    Observable,
    StateEvent,
    Variable,
    clipped,
    driven,
    lesser,
    limited,
    parameter,
    signal_input,
    state,
)

#: parameters without unit that are positive: permanent and temporary droop
POSITIVE = ("R", "r")
#: units of a signal in per unit and of its derivatives
DERIVATIVE = ("1", "1/s", "1/s2", "1/s3")


class Diagram:
    """A controller in the making; `declaration` ends it.  H = 0: its states have no energy, and it does no work."""

    def __init__(self, name: str):
        self.name = name
        self.states: list[Variable] = []
        self.parameters: list[Variable] = []
        self.rates: dict[Variable, Any] = {}
        self.events: list[StateEvent] = []
        self.values: dict[str, float] = {}

    def parameter(
        self,
        name: str,
        value: float,
        description: str = "",
        *,
        unit: str = "1",
        positive: bool = False,
        least: float | None = None,
    ) -> ca.SX:
        """A parameter by its standard name, at least `least`; times, droops and bases are positive."""
        self.values[name] = float(value)
        least = 0.0 if unit == "s" and positive and not value else least
        made = parameter(
            name, value, unit=unit, min=least, positive=positive and least is None, description=description
        )
        self.parameters.append(made)
        return made.sx

    def data(
        self, given: dict[str, float], seconds: Sequence[str] = (), units: Mapping[str, str] | None = None
    ) -> dict[str, ca.SX]:
        """Several parameters; those named in `seconds` are times, `units` has others that are not negative.

        ValueError for times below zero.
        """
        wrong = [f"{n} = {given[n]:g} s" for n in seconds if not given[n] >= 0]
        if wrong:
            raise ValueError(f"{self.name}: times must not be negative: {', '.join(wrong)}")
        told = {**(units or {}), **dict.fromkeys(seconds, "s")}
        positive, limited = {*seconds, *POSITIVE}, set(told).difference(seconds)
        return {
            n: self.parameter(n, v, unit=told.get(n, "1"), positive=n in positive, least=0.0 if n in limited else None)
            for n, v in given.items()
        }

    def time(self, name: str, value: float) -> str:
        """A single time constant; its name, by which blocks take it."""
        self.data({name: value}, (name,))
        return name

    def input(self, name: str, value: float, description: str, *, unit: str = "1") -> ca.SX:
        """A signal input."""
        made = signal_input(name, value, unit=unit, description=description)
        self.parameters.append(made)
        return made.sx

    def state(self, name: str, start: float = 0.0, description: str = "", *, unit: str = "1") -> Variable:
        """A state, in per unit if no other is told, whose rate `drive` says."""
        made = state(name, start=start, nominal=1.0, unit=unit, description=description)
        self.states.append(made)
        return made

    def drive(self, x: Variable, rate: Any, limits: tuple[Any, Any] | None = None, seconds: float = 1.0) -> None:
        """The rate of a state, with a limit without wind-up where `limits` = (lo, hi) are given."""
        self.rates[x] = rate if limits is None else self._with(limited(x, rate, *limits, seconds=seconds or 1.0))

    def clip(self, name: str, expr: Any, lo: Any, hi: Any, nominal: float = 1.0, *, unit: str = "1") -> ca.SX:
        """The value between its limits."""
        return self._with(clipped(name, expr, lo, hi, nominal=nominal, unit=unit))

    def lesser(self, name: str, a: Any, b: Any) -> ca.SX:
        """The lesser value."""
        return self._with(lesser(name, a, b))

    def lag(
        self, name: str, u: Any, T: str | None, K: Any = 1.0, limits: tuple[Any, Any] | None = None, start: float = 0.0
    ) -> ca.SX:
        """K u / (1 + s T), T the name of a parameter, with a limit without wind-up; at T = 0 the limit clips."""
        if T is None or not self.values[T]:
            return K * u if limits is None else self.clip(name, K * u, *limits)
        x = self.state(name, start)
        self.drive(x, (K * u - x.sx) / self._of(T), limits, self.values[T])
        return x.sx

    def lead_lag(self, name: str, u: Any, T1: str, T2: str) -> ca.SX:
        """u (1 + s T1)/(1 + s T2); ValueError for T2 = 0 with another T1."""
        if not self.values[T2]:
            if self.values[T1]:
                raise ValueError(
                    f"{self.name}: {T1} = {self.values[T1]:g} s needs {T2} > 0: its output would be a derivative"
                )
            return ca.SX(u)
        x = self.state(name)
        self.drive(x, (u - x.sx) / self._of(T2))
        return x.sx + self._of(T1) / self._of(T2) * (u - x.sx)

    def washout(self, name: str, u: Any, K: Any, T1: str, T2: str) -> ca.SX:
        """u s K T1/(1 + s T2).  ValueError for T2 = 0."""
        self._positive(T2)
        x = self.state(name)
        self.drive(x, (u - x.sx) / self._of(T2))
        return K * self._of(T1) / self._of(T2) * (u - x.sx)

    def feedback(self, name: str, u: Any, K: Any, T: str) -> ca.SX:
        """The stabilising feedback u s K/(1 + s T).  ValueError for T = 0."""
        return self.washout(name, u, K / self._of(T), T, T)

    def transfer(self, name: str, u: Any, num: Sequence[Any], den: Sequence[Any], order: int) -> ca.SX:
        """u (num[0] + num[1] s + ..)/(den[0] + den[1] s + ..), den of this order: states are derivatives of the first.

        ValueError where the numerator is of higher order.
        """
        if len(num) > order + 1:
            raise ValueError(
                f"{self.name}: the numerator of {name} is of order {len(num) - 1}, its denominator of {order}"
            )
        if not order:
            return num[0] / den[0] * u
        x = [self.state(f"{name}{k + 1}", unit=DERIVATIVE[k]) for k in range(order)]
        top = (u - sum((den[k] * x[k].sx for k in range(order)), ca.SX(0))) / den[order]
        derivatives = [v.sx for v in x] + [top]
        for k, v in enumerate(x):
            self.drive(v, derivatives[k + 1])
        return sum((n * derivatives[k] for k, n in enumerate(num)), ca.SX(0))

    def declaration(self, outputs: Sequence[Observable], description: str) -> PHDAE:
        """The controller with its signal outputs."""
        own = (driven("own", dict(self.rates), description="the diagram's rates; no work"),) if self.rates else ()
        return PHDAE(
            self.name, states=tuple(self.states), parameters=tuple(self.parameters), ports=own, observables=tuple(outputs),
            state_events=tuple(self.events), description=description,
        )  # fmt: skip

    def _with(self, limit: Limit) -> ca.SX:
        self.parameters.append(limit.mode)
        self.events.extend(limit.events)
        return limit.expr

    def _of(self, name: str) -> ca.SX:
        return next(p.sx for p in self.parameters if p.name == name)

    def _positive(self, name: str) -> None:
        if not self.values[name] > 0:
            raise ValueError(f"{self.name}: {name} = {self.values[name]:g} s must be positive")
