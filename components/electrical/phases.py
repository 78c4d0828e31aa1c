"""The phases of electrical parts: names and angles of three, and parts of one or three phases by the same declaration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi, sin, sqrt
from typing import Any

import casadi as ca

from phfmu import Energy, Variable, energy

#: names of the entries of three-phase quantities
PHASES = ("a", "b", "c")
#: angles by which the phases a, b, c of balanced quantities lag behind phase a
ALPHA = (0.0, 2.0 * pi / 3.0, -2.0 * pi / 3.0)


@dataclass(frozen=True)
class Phases:
    """One phase, whose quantities are scalars, or three, whose quantities have the entries a, b, c.

    Powers are those of all phases. A voltage V is rms, line to line of three phases, to ground of one: R = V^2/P holds for both,
    and so do rated peaks of currents, sqrt(2/count) S/V.
    """

    count: int

    @classmethod
    def of(cls, part: str, phases: int) -> Phases:
        """The phases of a part; ValueError for other numbers than 1 and 3."""
        if phases not in (1, 3):
            raise ValueError(f"{part}: phases = {phases}; a part has 3 phases, or 1")
        return cls(phases)

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the entries."""
        return PHASES if self.count == 3 else ()

    @property
    def each(self) -> dict[str, Any]:
        """Size and names of the entries, arguments of variables and ports."""
        return {"size": 3, "elements": PHASES} if self.count == 3 else {"size": None}

    @property
    def word(self) -> str:
        return "three-phase" if self.count == 3 else "single-phase"

    @property
    def peak(self) -> float:
        """Peak voltage of a phase to ground as a part of V."""
        return sqrt(2.0 / self.count)

    @property
    def angles(self) -> tuple[float, ...]:
        return ALPHA[: self.count]

    def values(self, phasor: complex, angle: float = 0.0) -> list[float] | float:
        """Values at t = 0 of the phases with the peak `phasor` of phase a, turned by `angle` [rad]."""
        found = [phasor.real * cos(angle - a) - phasor.imag * sin(angle - a) for a in self.angles]
        return found if self.count == 3 else found[0]

    def start(self, factor: float, values: float | Sequence[float]) -> list[float] | float:
        """`factor` times the values, one for all phases or one for each."""
        return [factor * x for x in values] if isinstance(values, Sequence) else factor * values

    def matrix(self, positive: Any, zero: Any) -> ca.SX:
        """The phase matrix of sequence values: (zero + 2 positive)/3 on, (zero - positive)/3 off it; of one positive."""
        if self.count == 1:
            return ca.SX(positive)
        return positive * ca.SX.eye(3) + (zero - positive) / 3.0 * ca.SX.ones(3, 3)

    def energy(self, x: Variable, positive: Any, zero: Any) -> Energy:
        """|x_12|^2/(2 positive) + |x_0|^2/(2 zero), where x_0 is the mean of the phases and x_12 is what is left of x."""
        if self.count == 1:
            return energy(x.sx**2 / (2.0 * positive), kind="quadratic")
        common = ca.sum1(x.sx) ** 2 / 3.0
        return energy((ca.sumsqr(x.sx) - common) / (2.0 * positive) + common / (2.0 * zero), kind="quadratic")

    def no_zero_sequence(self, part: str, **given: float | None) -> None:
        """ValueError for values of the zero sequence of a part with one phase."""
        wrong = [f"{name} = {value:g}" for name, value in given.items() if value is not None]
        if self.count == 1 and wrong:
            raise ValueError(f"{part}: {', '.join(wrong)} with one phase, which has no zero sequence; leave it out")
