"""Iron that saturates: magnetisation curves with a convex energy, and reactors of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot
from typing import Any

import casadi as ca

from phfmu import ELECTRICAL, PHDAE, Port, damping, energy, observable, parameter, state


@dataclass(frozen=True)
class MagnetisationCurve:
    """Flux and current of measured points, continued through the origin, oddly:  i = dH/d flux, a convex and smooth H.

    i(f) = g_0 f + sum_k (g_k - g_k-1) (s(f - f_k) - s(-f - f_k)),   s(x) = (x + sqrt(x^2 + w^2))/2,

    with the slopes g_k between the points. Its slope is everywhere a mean of the g_k: the current rises with the flux.
    `points`: (flux, current) with flux and current rising, without the origin; the last slope goes on beyond the last point.
    `rounding`: w as a part of the least distance of fluxes; a corner is missed by at most (g_k - g_k-1) w/2 of current.
    ValueError for points that do not rise, with their numbers.
    """

    points: Sequence[tuple[float, float]]
    rounding: float = 0.05

    def __post_init__(self) -> None:
        every = [(0.0, 0.0), *self.points]
        if not self.points or not self.rounding > 0:
            raise ValueError(
                f"MagnetisationCurve: {len(self.points)} points, rounding = {self.rounding:g}; give at least one point "
                "(flux, current) and a positive rounding"
            )
        for (f, i), (f1, i1) in pairwise(every):
            if not (f1 > f and i1 > i):
                raise ValueError(
                    f"MagnetisationCurve: after ({f:g}, {i:g}) comes ({f1:g}, {i1:g}); flux and current must both rise, from "
                    "the origin on: sort the points, and leave out those with remanence"
                )

    def scaled(self, flux: float, current: float) -> MagnetisationCurve:
        """The curve with its fluxes and currents multiplied, such as one in per unit by their bases."""
        return MagnetisationCurve([(f * flux, i * current) for f, i in self.points], self.rounding)

    def energy(self, flux: Any) -> ca.SX:
        """H(flux), a scalar expression, 0 at 0."""
        first, corners, w = self._corners
        return first * flux**2 / 2 + sum(more * _rounded(flux, corner, w) for corner, more in corners)

    def current(self, flux: Any) -> Any:
        """i(flux), of a number or an expression."""
        first, corners, w = self._corners
        return first * flux + sum(more * _bent(flux, corner, w) for corner, more in corners)

    @property
    def _corners(self) -> tuple[float, list[tuple[float, float]], float]:
        """g_0, the flux of each corner with the slope that it adds, and w."""
        every = [(0.0, 0.0), *self.points]
        slopes = [(i1 - i) / (f1 - f) for (f, i), (f1, i1) in pairwise(every)]
        added = [(f, after - before) for (f, _), (before, after) in zip(self.points, pairwise(slopes), strict=False)]
        return slopes[0], added, self.rounding * min(f1 - f for (f, _), (f1, _) in pairwise(every))


def _excess(x: Any, w: float) -> Any:
    """sqrt(x^2 + w^2) - x, without cancellation for any sign of x."""
    return w * ca.exp(-ca.asinh(x / w))


def _bent(f: Any, c: float, w: float) -> Any:
    """s(f - c) - s(-f - c) with s(x) = (x + sqrt(x^2 + w^2))/2, a multiple of f, so that its digits hold for small f."""
    e = _excess(c - f, w) + _excess(c + f, w)
    return f * e / (e + 2 * c)


def _rounded(f: Any, c: float, w: float) -> Any:
    """The integral of `_bent` from 0 to f, f^2 times a smooth function whose terms are as small as w^2/c^2 where f < c.

    With r = sqrt(c^2 + w^2), both roots r_1 + r_2 = u = 2 c + e at c - f and c + f, and d = (r_1 + r)(r_2 + r):

    4 integral = 2 f^2 e/u - c (u - 2 r) - w^2 (asinh((c - f)/w) + asinh((c + f)/w) - 2 asinh(c/w)),
    u - 2 r = f^2 (e (u + 2 c + 2 r) + 4 c (r - c))/(u d);  the last bracket is log(1 + f^2 k).
    """
    below, above = _excess(c - f, w), _excess(c + f, w)
    r, e = hypot(c, w), below + above
    u, left, right = e + 2 * c, below + c - f + r, above + c + f + r
    spread = (e * (u + 2 * c + 2 * r) + 4 * c * w**2 / (r + c)) / (u * left * right)
    shifts = (f - 2 * c - left) / left * ((f + 2 * c + right) / right)
    logarithm = ca.log1p(f**2 * ((c + r) * spread + shifts) / (c + r) ** 2)
    return (f**2 * (2 * e / u - c * spread) - w**2 * logarithm) / 4


def saturating_reactor(
    points: Sequence[tuple[float, float]],
    R: float = 0.0,
    *,
    rounding: float = 0.05,
    size: int | None = None,
    v: float = 1.0,
    flux0: float | Sequence[float] = 0.0,
) -> PHDAE:
    """Reactor to ground whose iron saturates:  flux' = terminal.v - R i,  i = dH/d flux.

    H:  that of the `MagnetisationCurve` of `points`, in each phase;  J: 0;  R: R
    states:      flux (size) [Wb]
    ports:       terminal: voltage given, current INTO the reactor out
    parameters:  R [ohm]
    observables: i (size) [A]
    `points`: flux [Wb] and current [A], both rising;  `rounding` [1]: of the corners;  `size`: phases;  `v`: typical voltage [V];
    `flux0`: flux at the start [Wb].  ValueError for points that do not rise and R < 0.
    """
    if R < 0:
        raise ValueError(f"saturating_reactor: R = {R:g} ohm must not be negative")
    curve = MagnetisationCurve(points, rounding)
    resistance = parameter("R", R, unit="ohm", description="resistance per phase")
    flux = state("flux", size, unit="Wb", start=flux0, nominal=points[0][0], description="flux linkage")
    parts = ca.vertsplit(flux.sx)
    return PHDAE(
        "saturating_reactor",
        states=(flux,),
        parameters=(resistance,),
        energies=tuple(energy(curve.energy(f)) for f in parts),
        dissipation=(damping(flux, resistance),),
        ports=(Port("terminal", ELECTRICAL, "effort", {flux: 1}, size=size, nominal=v, description="current into it"),),
        observables=(observable("i", flux.z, unit="A", description="current to ground"),),
        description="reactor to ground whose iron saturates",
    )
