"""Bushings: springs and dampers in the directions of a frame between two bodies, in place of a joint's equations.

With the frames A and B of both bodies at the bushing, r = p_b - p_a, and R = A^T B, counted from where it is not loaded,

    s_i = a_i . r,     4 e_i^2 = 1 + R_ii - R_jj - R_kk,     phi_i = 2 asin e_i,
    V = sum_i k_i s_i^2/2 + c_i s_i^4/4 + K_i phi_i^2/2 + C_i phi_i^4/4,

e being the vector of Euler parameters.  s_i and e_i^2 are of degree two in points and axes, so the schemes keep the energy and
the momenta exactly.  phi_i is the angle of a rotation about axis i alone, and of small rotations about any axis.

phi^2 = 4 asin^2 e is an analytic function of e^2 below 1, sum_n 2 (4 e^2)^n / (n^2 binom(2n, n)); its Pade approximant stands for
it, which has no singularity: the torque is K phi to 1e-9 up to 60, 2e-6 up to 90 and 5e-4 up to 120 degrees, and falls to zero at
half a turn, where it has no direction.
Sources: O. Bottema, B. Roth, Theoretical Kinematics (1979); I. Gradshteyn, I. Ryzhik, Table of Integrals, 1.645.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from math import comb
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from phfmu.components.mechanical.multibody.body import MechanismBody
from phfmu.components.mechanical.multibody.builder import Multibody
from phfmu.components.mechanical.multibody.joint import Side
from phfmu.components.mechanical.multibody.parts import LinearCombination, Particle

if TYPE_CHECKING:
    from phfmu.components.mechanical.multibody.declaration import Declaration

#: degree of both polynomials of the approximant
ORDER = 4
#: the square of twice the cosine of half the angle is at least this where the angle is told
SQUARE = 1e-12
AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Bushing:
    """A bushing between the bodies a and b (None: the ground); made by `Mechanism.bushing`.

    at_a, at_b [m], frame_a, frame_b (columns x, y, z): in the frames of the bodies, unloaded where they agree but for `neutral`
    stiffness, damping, hardening: 3 [N/m, N.s/m, N/m3] along and 3 [N.m/rad, N.m.s/rad, N.m/rad3] about the axes of a
    neutral [m]: displacement of b along these axes where it is not loaded
    """

    name: str
    a: MechanismBody | None
    b: MechanismBody | None
    at_a: np.ndarray
    at_b: np.ndarray
    frame_a: np.ndarray
    frame_b: np.ndarray
    planar: bool
    stiffness: np.ndarray
    damping: np.ndarray
    hardening: np.ndarray
    neutral: np.ndarray

    def __post_init__(self) -> None:
        for what in ("stiffness", "damping", "hardening"):
            found: np.ndarray = getattr(self, what)
            if not np.all(found >= 0):
                raise ValueError(f"bushing '{self.name}': its {what} {found.tolist()} must not be negative")
        if not np.any(self.stiffness) and not np.any(self.damping) and not np.any(self.hardening):
            raise ValueError(f"bushing '{self.name}' has neither stiffness nor damping")
        for side in "ab":
            body, at = getattr(self, side), getattr(self, f"at_{side}")
            if body is None or body.directors == 3:
                continue
            off = body.principal(at)[body.directors :]
            if side == "a" or self.turns or np.max(np.abs(off), initial=0.0) > 1e-12:
                what = "point mass" if body.directors == 0 else "rod"
                raise ValueError(
                    f"bushing '{self.name}': body '{body.name}' is a {what}, without directions for it; make it the second "
                    "body, held at a point of its own and without stiffness and damping of rotation, or make it a body"
                )

    @property
    def turns(self) -> bool:
        """It acts on rotations."""
        return any(np.any(v[3:]) for v in (self.stiffness, self.damping, self.hardening))


class BushingEquations:
    """A bushing in the making: its sides, its parameters, and what it stores and dissipates.

    principal: principal axes of its second body;  points: the particles of both bodies
    """

    def __init__(
        self,
        made: Multibody,
        bushing: Bushing,
        sides: tuple[Callable[[Any], Side], Callable[[Any], Side]],
        principal: list[LinearCombination],
        points: list[Particle],
    ):
        self.made, self.bushing, self.sides, self.principal, self.points = made, bushing, sides, principal, points
        self.dim = made.dim
        #: parameter of a property in a direction, where it is not zero
        self.value: dict[tuple[str, int], ca.SX] = {}

    def add(self, observe: bool) -> None:
        """Its energies, friction and observables."""
        b, units = self.bushing, (("N/m", "N.m/rad"), ("N.s/m", "N.m.s/rad"), ("N/m3", "N.m/rad3"))
        for what, unit in zip(("stiffness", "damping", "hardening"), units, strict=True):
            for i in np.flatnonzero(getattr(b, what)):
                label = f"{b.name}.{what}_{'about_' if i > 2 else ''}{AXES[i % 3]}"
                text = f"of {b.name} {'about' if i > 2 else 'along'} its {AXES[i % 3]} axis"
                given = float(getattr(b, what)[i])
                self.value[what, int(i)] = self.made.parameter(
                    label, given, unit=unit[int(i > 2)], min=0.0, description=text
                ).sx
        # where one is displaced all have the parameter, so that they are of one kind
        for i in range(self.dim) if np.any(b.neutral) else ():
            label, text = f"{b.name}.neutral_{AXES[i]}", f"displacement at which {b.name} is not loaded"
            self.value["neutral", int(i)] = self.made.parameter(
                label, float(b.neutral[i]), unit="m", description=text
            ).sx
        for i in range(6):
            if any((what, i) in self.value for what in ("stiffness", "hardening")):
                invariant = self._along(i) if i < 3 else self._turned(i - 3)
                self.made.strain(invariant, self._energy(i))
            if ("damping", i) in self.value:
                self.made.rate_damper(
                    self.points, lambda at, speed, i=i: self._rate(i, at, speed), self.value["damping", i]
                )
        if observe:
            self._observe()

    # -- displacement and rotation ------------------------------------------------------------------------------------

    def _seen(self, of: Any) -> tuple[Side, Side]:
        a, b = self.sides
        return a(of), b(of)

    def _along(self, i: int) -> Callable[[Any], ca.SX]:
        """Displacement along axis i of a."""

        def displacement(at: Any) -> ca.SX:
            a, b = self._seen(at)
            return ca.dot(getattr(a, AXES[i]), b.p - a.p)

        return displacement

    def _turned(self, i: int) -> Callable[[Any], ca.SX]:
        """The square e_i^2 of an Euler parameter."""

        def square(at: Any) -> ca.SX:
            a, b = self._seen(at)
            return _euler_square(i, a, b, self.dim)

        return square

    def _energy(self, i: int) -> Callable[[ca.SX], ca.SX]:
        """Stored in direction i, of s_i or of e_i^2 [J]."""
        k, c = (self.value.get((what, i), ca.SX(0)) for what in ("stiffness", "hardening"))

        def stored(invariant: ca.SX) -> ca.SX:
            shift = self.value.get(("neutral", i), ca.SX(0))
            square = (invariant - shift) ** 2 if i < 3 else _angle_square(invariant)
            return 0.5 * k * square + 0.25 * c * square**2

        return stored

    def _rate(self, i: int, at: Any, speed: Any) -> ca.SX:
        """Rate of s_i, or angular velocity of b beside a about axis i of a."""
        if i >= 3:
            return self._turning(i - 3, at, speed)
        (a, b), (da, db) = self._seen(at), self._seen(speed)
        axis = AXES[i]
        return ca.dot(getattr(a, axis), db.p - da.p) + ca.dot(getattr(da, axis), b.p - a.p)

    def _turning(self, i: int, at: Any, speed: Any) -> ca.SX:
        """w_i = sum_j c_kj c_lj', i, k, l in turn, of the cosines c_kj = a_k . e_j; in the plane k, l = x, y.

        Made of cosines alone, it vanishes where both bodies turn together, also for means of positions, whose axes are not
        orthogonal: what brakes one body drives the other, and no angular momentum is made.
        """
        (a, _), (da, _) = self._seen(at), self._seen(speed)
        k, l = (AXES[(i + 1) % 3], AXES[(i + 2) % 3]) if self.dim == 3 else "xy"
        first, second, rate = getattr(a, k), getattr(a, l), getattr(da, l)
        axes = [(at(point), speed(point)) for point in self.principal]
        return sum((ca.dot(first, e) * (ca.dot(rate, e) + ca.dot(second, de)) for e, de in axes), ca.SX(0))

    # -- what it tells --------------------------------------------------------------------------------------------------

    def _observe(self) -> None:
        m, name, n = self.made, self.bushing.name, self.dim
        turning = self.bushing.turns
        m.observable(
            f"{name}.displacement", "m", self._displacement, f"of {name} along its axes, from where it is not loaded"
        )
        m.observable(f"{name}.force", "N", self._force, f"of {name} on its second body")
        m.observable(f"{name}.energy", "J", lambda d: sum(self._stored(d), ca.SX(0)), f"stored in {name}")
        if turning:
            text = f"of {name} about its axis" if n == 2 else f"of {name} about its axes"
            m.observable(f"{name}.rotation", "rad", lambda d: _angles(*self._seen(d.at), n), text)
            m.observable(f"{name}.torque", "N.m", self._torque, f"of {name} on its second body")

    def _directions(self, first: int) -> Iterator[tuple[int, ca.SX, ca.SX]]:
        """Directions from `first` with something in them."""
        for i in range(first, first + 3):
            if any((what, i) in self.value for what in ("stiffness", "damping", "hardening")):
                yield i, self.value.get(("damping", i), ca.SX(0)), self.value.get(("neutral", i), ca.SX(0))

    def _stored(self, d: Declaration) -> list[ca.SX]:
        """Per direction with something in it [J]."""
        return [
            self._energy(i)(self._along(i)(d.at) if i < 3 else self._turned(i - 3)(d.at))
            for first in (0, 3)
            for i, _, _ in self._directions(first)
        ]

    def _displacement(self, d: Declaration) -> ca.SX:
        return ca.vertcat(*(self._along(i)(d.at) - self.value.get(("neutral", i), 0) for i in range(self.dim)))

    def _force(self, d: Declaration) -> ca.SX:
        a, _ = self._seen(d.at)
        total, s = ca.SX(self.dim, 1), ca.SX.sym("s")
        for i, friction, _ in self._directions(0):
            slope = ca.substitute(ca.gradient(self._energy(i)(s), s), s, self._along(i)(d.at))
            total -= (slope + friction * self._rate(i, d.at, d.speed)) * getattr(a, AXES[i])
        return total

    def _torque(self, d: Declaration) -> ca.SX:
        """-sum_j b_j x dV/db_j and the friction about the axes of a."""
        a, b = self._seen(d.at)
        total, s = ca.SX(1 if self.dim == 2 else 3, 1), ca.SX.sym("s")
        for i, friction, _ in self._directions(3):
            slope = ca.substitute(ca.gradient(self._energy(i)(s), s), s, self._turned(i - 3)(d.at))
            rate = friction * self._rate(i, d.at, d.speed)
            if self.dim == 2:
                total -= slope * 0.5 * _cross(a.x, b.x) + rate
                continue
            arm = sum(
                ((1 if j == i - 3 else -1) * ca.cross(getattr(b, AXES[j]), getattr(a, AXES[j])) / 4 for j in range(3)),
                ca.SX(3, 1),
            )
            total -= slope * arm + rate * getattr(a, AXES[i - 3])
        return total


def _euler_square(i: int, a: Side, b: Side, dim: int) -> ca.SX:
    """e_i^2 of the rotation from the axes of a to those of b, of 1 - a_j . b_j = |b_j - a_j|^2/2: small where it is small."""
    if dim == 2:
        return 0.25 * ca.sumsqr(b.x - a.x)
    own, *others = (ca.sumsqr(getattr(b, AXES[j]) - getattr(a, AXES[j])) for j in (i, *(k for k in range(3) if k != i)))
    return 0.125 * (others[0] + others[1] - own)


def _angle_square(square: ca.SX) -> ca.SX:
    """phi^2 of e^2."""
    over, under = _law()
    return square * _polynomial(over, square) / _polynomial(under, square)


@cache
def _law() -> tuple[list[float], list[float]]:
    """Coefficients of the approximant [4/4] of phi^2/e^2, from the highest power on."""
    from scipy.interpolate import pade

    series = [2.0 * 4**n / (n**2 * comb(2 * n, n)) for n in range(1, 2 * ORDER + 2)]
    return tuple(p.coeffs.tolist() for p in pade(series, ORDER))


def _polynomial(coefficients: list[float], x: ca.SX) -> ca.SX:
    total = ca.SX(0)
    for c in coefficients:
        total = total * x + c
    return total


def _angles(a: Side, b: Side, dim: int) -> ca.SX:
    """phi with its signs; from the skew part of R, which rounding does not touch where it is small; bounded at half a turn."""
    if dim == 2:
        return ca.atan2(_cross(a.x, b.x), ca.dot(a.x, b.x))
    skew = 0.5 * ca.vertcat(
        ca.dot(a.z, b.y) - ca.dot(a.y, b.z), ca.dot(a.x, b.z) - ca.dot(a.z, b.x), ca.dot(a.y, b.x) - ca.dot(a.x, b.y)
    )
    trace = sum((ca.dot(getattr(a, x), getattr(b, x)) for x in AXES), ca.SX(0))
    e = skew / ca.sqrt(ca.fmax(1 + trace, SQUARE))
    return 2 * ca.asin(ca.fmax(-1, ca.fmin(1, e)))


def _cross(x: ca.SX, y: ca.SX) -> ca.SX:
    """x x y in the plane."""
    return x[0] * y[1] - x[1] * y[0]
