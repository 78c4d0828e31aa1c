"""Specifications of an operating point: what is known at a three-phase port, in instantaneous quantities.

With the balanced voltage v and current i into the member (two numbers each, in the basis `BALANCED`):

    |v| = V (rms, line to line),   P = v.i,   Q = (G v).i = -v.(G i),   angle of phase a of v.

Each specification stands at a port of one member; for each of its equations a value of the network is freed: an input, a
parameter or a set point, whose name is `member.name`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, inf, sin

import numpy as np
from numpy.typing import NDArray

from phfmu.operating.rotation import BALANCED, TURN

Array = NDArray[np.float64]

#: generator of the rotation in the basis of balanced quantities
QUARTER = BALANCED.T @ TURN @ BALANCED


#: values of the equations of a specification and their derivatives by v (n x 2), i (n x 2) and what is freed (n x n)
Residual = tuple[Array, Array, Array, Array]


@dataclass(frozen=True)
class Specification:
    """Equations at the port `port` (`member.name`), as many as values are freed in exchange.

    `free`: their names, of inputs or parameters of any member; for a member with two scalar inputs (field and shaft of a machine)
    these by default.  The values begin at their start values.
    """

    port: str
    free: Sequence[str] | None = None

    @property
    def sets_power(self) -> bool:
        """Whether it says what power flows at the port."""
        return True

    @property
    def count(self) -> int:
        """Number of equations."""
        return 2

    def residual(self, v: Array, i: Array, free: Array, omega: float) -> Residual:
        """The equations, relative to what they ask for, for voltage v and current i (2 each) and the freed values."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Slack(Specification):
    """Voltage V [V rms, line to line] and its angle [rad]: the bus that takes what is left over."""

    V: float
    angle: float = 0.0

    @property
    def sets_power(self) -> bool:
        return False

    def residual(self, v: Array, i: Array, free: Array, omega: float) -> Residual:
        across = np.array([sin(self.angle), -cos(self.angle)]) / self.V
        value = np.array([v @ v / self.V**2 - 1.0, across @ v])
        return value, np.vstack([2.0 * v / self.V**2, across]), np.zeros((2, 2)), np.zeros((2, 2))


@dataclass(frozen=True, kw_only=True)
class PV(Specification):
    """Delivered active power P [W] and voltage V [V rms, line to line]: a generator with a voltage regulator.

    Q [var]: the least and the most reactive power that it delivers; where V asks for more it is a `PQ` at the limit.
    """

    P: float
    V: float
    Q: tuple[float, float] = (-inf, inf)

    def __post_init__(self) -> None:
        if not self.Q[0] <= self.Q[1]:
            raise ValueError(f"PV at {self.port}: Q is within {self.Q[0]:g} and {self.Q[1]:g} var, which is nowhere")

    def residual(self, v: Array, i: Array, free: Array, omega: float) -> Residual:
        size = abs(self.P) or self.V**2 / omega
        value = np.array([v @ v / self.V**2 - 1.0, (v @ i + self.P) / size])
        by_v, by_i = np.vstack([2.0 * v / self.V**2, i / size]), np.vstack([np.zeros(2), v / size])
        return value, by_v, by_i, np.zeros((2, 2))


@dataclass(frozen=True, kw_only=True)
class PQ(Specification):
    """Delivered active power P [W] and reactive power Q [var]; negative ones are taken."""

    P: float
    Q: float

    def residual(self, v: Array, i: Array, free: Array, omega: float) -> Residual:
        size = max(abs(self.P), abs(self.Q)) or 1.0
        value = np.array([v @ i + self.P, v @ QUARTER @ i + self.Q]) / size
        by_v, by_i = np.vstack([i, QUARTER @ i]) / size, np.vstack([v, v @ QUARTER]) / size
        return value, by_v, by_i, np.zeros((2, 2))


@dataclass(frozen=True, kw_only=True)
class Load(Specification):
    """Active power P [W] that the resistance R of a member takes, and reactive power Q [var] that its inductance L takes.

    P R = |v|^2,  Q w L = |v|^2:  R and L of the member are found, which may have a capacitance beside them.  A negative Q is
    delivered by its capacitance instead: -Q = w (C - beside) |v|^2, in which `beside` [F] is what C has besides the load.
    A power of 0 leaves its parameter as it is.  These equations are regular from a start without current, those of v and i
    are not.
    """

    P: float
    Q: float = 0.0
    beside: float = 0.0

    def __post_init__(self) -> None:
        if self.P < 0:
            raise ValueError(f"Load at {self.port}: P = {self.P:g} W must not be negative; use PQ")

    @property
    def freed(self) -> tuple[str, ...]:
        """The parameters of the member that are found."""
        reactive = "L" if self.Q > 0 else "C"
        return tuple(name for name, power in (("R", self.P), (reactive, self.Q)) if power)

    @property
    def count(self) -> int:
        return len(self.freed)

    def residual(self, v: Array, i: Array, free: Array, omega: float) -> Residual:
        square, n = v @ v, self.count
        values, by_v, by_free = np.empty(n), np.empty((n, 2)), np.zeros((n, n))
        for k, (name, x) in enumerate(zip(self.freed, free, strict=True)):
            if name == "C":
                size = -self.Q
                values[k] = omega * (x - self.beside) * square / size - 1.0
                by_v[k], by_free[k, k] = 2.0 * omega * (x - self.beside) * v / size, omega * square / size
            else:
                size = x * (self.P if name == "R" else self.Q * omega)
                values[k], by_v[k], by_free[k, k] = square / size - 1.0, 2.0 * v / size, -square / size / x
        return values, by_v, np.zeros((n, 2)), by_free
