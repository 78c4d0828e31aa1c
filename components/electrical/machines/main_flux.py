"""Saturation of the main flux: no-load curves of synchronous machines, and the convex energy that they add.

The fluxes of the windings on an axis are psi = Lambda i + n m with the leakages Lambda, the turns n seen from the stator and the
main flux m. The unsaturated core stores m_d^2/(2 Lmd) + m_q^2/(2 Lmq); iron adds a convex w(|m|). The energy of all windings is
the least over m of what leakages and core store, so it is convex in psi, and its excess over the linear machine is

    E(mu) = min over m of  sum_a c_a (mu_a - m_a)^2/2 + w(|m|),    c_a = 1/Lm_a + n^T Lambda^-1 n,

with the main flux mu_a = n^T Lambda^-1 psi/c_a of the linear machine at the same psi.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import inf, isfinite, log, sqrt
from typing import Any, Literal

import casadi as ca

from phfmu import Variable, parameter
from phfmu.components.electrical.network.saturation import MagnetisationCurve

#: the second point of a no-load curve of two points, in parts of the rated voltage
SECOND = 1.2
#: added to the square of a main flux, in parts of the rated one: its root has derivatives at 0
SMALLEST = 1e-16
#: steps of Newton's method for |m|, by the curve
STEPS = {"quadratic": 1, "exponential": 3, "table": 3}

Kind = Literal["quadratic", "exponential"]


@dataclass(frozen=True)
class Saturation:
    """The no-load curve of a machine in per unit: S(u) = i_f/u - 1 at the voltage u, where i_f = u is the air-gap line.

    quadratic:    S(u) = B (u - A)^2/u above A, 0 below, through S(1) = S10 and S(1.2) = S12; A = 1 where S10 = 0
    exponential:  S(u) = S10 u^n,  n = log(S12/S10)/log(1.2)
    points:       measured (u, i_f) that rise, with slopes that rise from the 1 of the air-gap line: a `MagnetisationCurve`

    It holds for the main flux m in per unit of the rated one: iron takes the current S(|m|) m/Lmd beside that of the air gap.
    `axes`: "dq" for |m| of both axes, a round rotor (GENROU); "d" for m_d alone, salient poles (GENSAL).
    `rounding`: of the corners between points.
    Source: the quadratic and exponential saturation of the models GENROU, GENSAL, GENROE and GENSAE of PSS/E; Kundur, Power
    System Stability and Control, 1994, section 3.8.
    """

    S10: float = 0.0
    S12: float = 0.0
    kind: Kind = "quadratic"
    points: tuple[tuple[float, float], ...] = ()
    axes: Literal["dq", "d"] = "dq"
    rounding: float = 0.05

    @property
    def form(self) -> str:
        """quadratic, exponential or table."""
        return "table" if self.points else self.kind

    def problems(self) -> list[tuple[str, str]]:
        """Points and numbers for which the energy is not convex, or the curve is none, with the numbers and the remedy."""
        if self.axes not in ("dq", "d") or self.kind not in ("quadratic", "exponential"):
            text = f"saturation: axes = '{self.axes}', kind = '{self.kind}'"
            return [(text, "give axes = 'dq' or 'd', kind = 'quadratic' or 'exponential'")]
        return self._wrong_points() if self.points else self._wrong_pair()

    def _wrong_pair(self) -> list[tuple[str, str]]:
        S10, S12 = self.S10, self.S12
        named = f"saturation: S(1.0) = {S10:g}, S(1.2) = {S12:g}"
        if not (isfinite(S10) and isfinite(S12) and 0 <= S10 and 0 < S12):
            return [(named, "give 0 <= S(1.0) < S(1.2), both in per unit; leave saturation out for a linear machine")]
        if self.kind == "quadratic" and not S12 >= SECOND * S10:
            A = (sqrt(SECOND * S12) - SECOND * sqrt(S10)) / ((sqrt(SECOND * S12) - sqrt(S10)) or inf)
            text = (
                f"{named}: the quadratic curve through them begins at A = {A:.4g}, and an energy with A < 0 is not "
                "convex at 0: S(1.2) must be at least 1.2 S(1.0)"
            )
            return [(text, "check the values, or take kind='exponential'")]
        if self.kind == "exponential" and not (S10 > 0 and S12 >= S10):
            return [(f"{named}: an exponential curve rises from a positive S(1.0)", "take kind='quadratic'")]
        return []

    def _wrong_points(self) -> list[tuple[str, str]]:
        if self.S10 or self.S12:
            return [("saturation: points beside S(1.0) or S(1.2)", "give one of them")]
        try:
            MagnetisationCurve(self.points, self.rounding)
        except (ValueError, TypeError) as error:
            return [(f"saturation: {error}", "give (u, i_f) in per unit, sorted")]
        every = [(0.0, 0.0), *self.points]
        slopes = [1.0, *((i1 - i) / (u1 - u) for (u, i), (u1, i1) in pairwise(every))]
        return [
            (f"saturation: the slope of the no-load curve falls from {before:.6g} to {after:.6g} before the point {point}: "
             "its energy beside that of the air gap is not convex", "give i_f in parts of the current that brings u = 1 on the "
             "air-gap line, and points whose slopes rise")
            for point, (before, after) in zip(self.points, pairwise(slopes), strict=True)
            if after < before * (1 - 1e-9)
        ]  # fmt: skip

    @property
    def corner(self) -> tuple[float, float]:
        """A and B of the quadratic curve."""
        low, high = sqrt(self.S10), sqrt(SECOND * self.S12)
        return (high - SECOND * low) / (high - low), ((high - low) / (SECOND - 1.0)) ** 2

    @property
    def exponent(self) -> float:
        """n of the exponential curve."""
        return log(self.S12 / self.S10) / log(SECOND)

    def curve(self) -> NoLoadCurve:
        """The curve with its numbers as tunable parameters; every value that they may have is convex."""
        if self.form == "quadratic":
            A, B = self.corner
            return NoLoadCurve(self, (
                parameter("A_sat", A, unit="1", min=0.0, description="main flux at which saturation begins, of the rated one"),
                parameter("B_sat", B, unit="1", min=0.0, description="growth of saturation: S u = B_sat (u - A_sat)^2"),
            ))  # fmt: skip
        if self.form == "exponential":
            return NoLoadCurve(self, (
                parameter("S_sat", self.S10, unit="1", positive=True, description="saturation at the rated main flux"),
                parameter("n_sat", self.exponent, unit="1", min=0.0, description="exponent of saturation: S = S_sat u^n_sat"),
            ))  # fmt: skip
        return NoLoadCurve(self, ())

    def current(self, u: float) -> float:
        """S(u) u, the field current beside that of the air gap at the main flux u, both in per unit."""
        return float(self._current(abs(u)))

    def S(self, u: float) -> float:
        """S(u), 0 without a main flux."""
        return self.current(u) / u if u else 0.0

    @cached_property
    def _current(self) -> ca.Function:
        """S(u) u as a function of numbers."""
        curve, at = self.curve(), ca.SX.sym("u")
        values = [float(p.start[0]) for p in curve.parameters]
        return ca.Function(
            "current", [at], ca.substitute([curve.current(at)[0]], [p.sx for p in curve.parameters], values)
        )


@dataclass(frozen=True)
class NoLoadCurve:
    """A no-load curve in expressions: current S(r) r and energy w(r) of iron at the main flux r, all in per unit."""

    data: Saturation
    parameters: tuple[Variable, ...]

    def energy(self, r: Any) -> ca.SX:
        """w(r), convex, with w' = S(r) r."""
        if self.data.points:
            return MagnetisationCurve(self.data.points, self.data.rounding).energy(r) - r**2 / 2
        first, second = (p.sx for p in self.parameters)
        if self.data.form == "exponential":
            return first * r**second * r**2 / (second + 2)
        return second * ca.fmax(r - first, 0) ** 3 / 3

    def current(self, r: ca.SX) -> tuple[ca.SX, ca.SX]:
        """S(r) r and its derivative."""
        if self.data.points:
            at = ca.SX.sym("r")
            i = MagnetisationCurve(self.data.points, self.data.rounding).current(at) - at
            both = ca.substitute(ca.vertcat(i, ca.gradient(i, at)), at, r)
            return both[0], both[1]
        first, second = (p.sx for p in self.parameters)
        if self.data.form == "exponential":
            S = first * r**second
            return S * r, (second + 1) * S
        beyond = ca.fmax(r - first, 0)
        return second * beyond**2, 2 * second * beyond

    def excess(self, mu: Sequence[ca.SX], stiffness: Sequence[ca.SX]) -> ca.SX:
        """E(mu) in per unit, from the main fluxes mu_a of the linear machine and c_a = `stiffness`, for one axis or two.

        The least lies at m_a = mu_a/(1 + S/c_a). With 1/c the mean of 1/c_a in the direction of mu, |m| = r solves
        r + S(r) r/c = |mu| up to S^2 (1/c_a - 1/c), which the steps of Newton's method take along. An r that is not exact
        changes E by the square of its error, and E is the energy, to the bit.
        """
        size = _length(mu)
        c = size**2 / sum((x**2 / k for x, k in zip(mu, stiffness, strict=True)), SMALLEST / stiffness[0])
        r = self._first(size, c)
        exact = self.data.form == "quadratic" and len(mu) == 1
        for _ in range(0 if exact else STEPS[self.data.form]):
            i, slope = self.current(r)
            reached = size
            if len(mu) > 1:
                S = i / r
                reached = _length([x * (1 + S / c) / (1 + S / k) for x, k in zip(mu, stiffness, strict=True)])
            r = r - (r + i / c - reached) / (1 + slope / c)
        S = self.current(r)[0] / r
        apart = [x * S / (k + S) for x, k in zip(mu, stiffness, strict=True)]
        inside = _length([x - d for x, d in zip(mu, apart, strict=True)])
        return sum((k * d**2 / 2 for d, k in zip(apart, stiffness, strict=True)), self.energy(inside))

    def _first(self, size: ca.SX, c: ca.SX) -> ca.SX:
        """The solution of r + S(r) r/c = size where it has a closed form, else one that is right for small and large S."""
        if self.data.points:
            return size
        first, second = (p.sx for p in self.parameters)
        if self.data.form == "exponential":
            return size * (1 + (second + 1) * first * size**second / c) ** (-1 / (second + 1))
        beyond = ca.fmax(size - first, 0)
        return size - beyond + 2 * beyond / (1 + ca.sqrt(1 + 4 * second * beyond / c))


def _length(x: Sequence[ca.SX]) -> ca.SX:
    """|x|, with derivatives at 0."""
    return ca.sqrt(sum((y**2 for y in x), ca.SX(SMALLEST)))
