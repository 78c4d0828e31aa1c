"""A builder for particle systems with springs, dampers, bars, gravity, supports, constraints and ports.

q' = v,   M v' = -DV(q) - R(q) v - Dg(q, t)^T lambda + B u,   0 = Dg v + g_t,   H = 1/2 v^T M v + V(q)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

from phfmu import (
    PHDAE,
    Domain,
    ShapeKind,
    Variable,
    parameter,
    time,
)
from phfmu.components.mechanical.multibody.declaration import Declaration
from phfmu.components.mechanical.multibody.parts import (
    Constraint,
    Damper,
    DrivenPoint,
    ElasticBond,
    Given,
    HardContact,
    LinearCombination,
    MovingSupport,
    Particle,
    ParticleSystem,
    Places,
    Point,
    PointMass,
    PositionObservable,
    Rate,
    RateDamper,
    RateIntegral,
    RatePort,
    Scalar,
    Solid,
    Strain,
    Support,
)


class Multibody:
    """Particles in `dim` = 1, 2 or 3 dimensions; add parts, then `build()` the declaration.

    `parts` is what was added so far: masses with their starts, springs, dampers, bars, constraints, ports.  Springs, dampers
    and constraints may depend on parameters made by `parameter`.  Errors: ValueError names the part and the numbers.
    """

    def __init__(self, name: str, dim: int = 3, description: str = ""):
        self.parts = ParticleSystem(name, dim, description)

    @property
    def name(self) -> str:
        return self.parts.name

    @property
    def dim(self) -> int:
        return self.parts.dim

    # -- points -----------------------------------------------------------------------------------------------------

    def particle(
        self,
        mass: float,
        q: Sequence[float],
        v: Sequence[float] | None = None,
        *,
        weight: bool = True,
        name: str = "",
    ) -> Particle:
        """A point mass [kg] at q [m] with velocity v [m/s] (default: at rest).

        Mass 0 is allowed where constraints fix the point; `weight=False`: gravity does not act on it; `name`: in pictures.
        """
        label = f"particle {len(self.parts.masses) + 1}"
        velocity = [0.0] * self.dim if v is None else list(v)
        self._sized(f"{label}: q", q)
        self._sized(f"{label}: v", velocity)
        if not mass >= 0:
            raise ValueError(
                f"{self.name}: {label}: mass {mass} kg must be positive, or 0 where constraints fix the point"
            )
        self.parts.masses.append(
            PointMass(float(mass), tuple(map(float, q)), tuple(map(float, velocity)), weight, name)
        )
        return Particle(len(self.parts.masses) - 1)

    def support(self, position: Sequence[float]) -> Support:
        """A fixed point."""
        self._sized("a support", position)
        return Support(tuple(map(float, position)))

    def moving_support(self, name: str, position: Callable[[ca.SX], Sequence[Any]]) -> MovingSupport:
        """A point led along position(t) [m] for bars and constraints; their work is booked at the port `name`."""
        self._sized(f"moving support '{name}'", position(time))
        return MovingSupport(name, position)

    def driven_point(self, name: str, q: Sequence[float]) -> DrivenPoint:
        """A point at q [m] that carries springs and dampers: port `name` with velocity given, force out."""
        self._sized(f"driven point '{name}'", q)
        self.parts.driven.append(DrivenPoint(name, tuple(map(float, q))))
        return self.parts.driven[-1]

    # -- forces -----------------------------------------------------------------------------------------------------

    def parameter(
        self,
        name: str,
        value: Any,
        size: int | None = None,
        *,
        unit: str = "1",
        min: float | None = None,
        positive: bool = False,
        description: str = "",
    ) -> Variable:
        """A parameter that springs, dampers, constraints and rates may use; `min`, `positive`: its limits."""
        made = parameter(name, value, size, unit=unit, min=min, positive=positive, description=description)
        self.parts.parameters.append(made)
        return made

    def spring(self, a: Point, b: Point, potential: Scalar) -> None:
        """An elastic bond with energy potential(s) of the squared distance s = |b - a|^2 [m2]."""
        self._at_rest("spring", a, b)
        self.parts.springs.append(ElasticBond(a, b, potential))

    def distance_spring(self, a: Point, b: Point, potential: Scalar) -> None:
        """An elastic bond with energy potential(r) of the distance r = |b - a| [m]."""
        self.spring(a, b, lambda s: potential(ca.sqrt(s)))

    def linear_spring(self, a: Point, b: Point, k: Any, length: Any) -> None:
        """1/2 k (|b - a| - length)^2 with k in N/m."""
        self.distance_spring(a, b, lambda r: 0.5 * k * (r - length) ** 2)

    def quartic_spring(self, a: Point, b: Point, k: Any, length: float = 1.0) -> None:
        """1/2 k (|b - a|^2 - length^2)^2 with k in N/m3."""
        self.spring(a, b, lambda s: 0.5 * k * (s - length**2) ** 2)

    def strain(self, invariant: Callable[[Places], ca.SX], potential: Scalar) -> None:
        """The energy potential(c) [J] of an invariant c of positions, of degree two at most: exact at every order."""
        self.parts.strains.append(Strain(invariant, potential))

    def potential(self, energy_of: Callable[[Places], ca.SX]) -> None:
        """Any energy [J] of positions; `energy_of` gets a function `at` of points, see `constraint`."""
        self.parts.potentials.append(energy_of)

    def damper(self, a: Point, b: Point, value: Scalar | Any, *, axial: bool = False) -> None:
        """A damper with coefficient [N.s/m], a number, parameter, or function of the squared distance s.

        It acts on the full relative velocity, or, `axial`, on its part along the line from a to b.
        """
        self._at_rest("damper", a, b)
        of_s: Any = value if callable(value) else lambda s: ca.SX(getattr(value, "sx", value))
        self.parts.dampers.append(Damper(a, b, of_s, axial))

    def gravity(self, acceleration: Sequence[float]) -> None:
        """A uniform field [m/s2]."""
        self._sized("gravity", acceleration)
        self.parts.gravity = tuple(map(float, acceleration))

    # -- constraints and ports --------------------------------------------------------------------------------------

    def bar(self, a: Point, b: Point, length: float | None = None) -> None:
        """A massless rigid bar, g = (|b - a|^2 - length^2)/2; length defaults to the distance at the start."""
        self._not_driven("a bar", a, b)
        d = [y - x for x, y in zip(self._start(a), self._start(b), strict=True)]
        distance = sum(x * x for x in d) ** 0.5 if length is None else float(length)
        if not distance > 0:
            raise ValueError(
                f"{self.name}: a bar between {_label(a)} and {_label(b)} has length {distance:g} m; it needs a positive one"
            )
        self.parts.bars.append(
            Constraint(
                lambda at: 0.5 * (ca.sumsqr(at(b) - at(a)) - distance**2), f"bar {_label(a)}-{_label(b)}", (a, b)
            )
        )

    def constraint(
        self,
        g: Callable[[Places], Any],
        name: str = "",
        *,
        drive: str = "",
        multiplier: tuple[str, str] | None = None,
        kept: bool = False,
    ) -> None:
        """Holonomic constraints g = 0 (one, or a column) of positions: `constraint(lambda at: at(piston)[1])` keeps y = 0.

        `g` gets a function `at`: at(piston) is the position [m] of a point as a column of `dim` entries, which count from 0 as
        everywhere in Python: [0] is x, [1] is y, [2] is z.  Names in results count from 1: q[1] is x of the first particle.
        g may use `phfmu.time` and moving supports; then its work is booked at the port `drive` (default: the name of the
        moving support, else `drive`).  `multiplier`: name and unit of multipliers of their own instead of `lambda`;
        `kept`: where constraints depend on each other, others rest.
        """
        label = name or f"constraint {len(self.parts.constraints) + 1}"
        self.parts.constraints.append(Constraint(g, label, drive=drive, multiplier=multiplier, kept=kept))

    def port(self, name: str, particle: Particle, base: Particle | None = None) -> None:
        """A port at a particle: force given, velocity out (`dim` scalar pairs); with `base`, both relative to it."""
        self.parts.ports.append((name, particle, base))

    # -- rates: linear forms J(q) v of velocities -------------------------------------------------------------------

    def rate_port(
        self, name: str, domain: Domain, given: Given, points: Sequence[Point], rate: Rate, description: str = ""
    ) -> None:
        """A port at a rate J(q) v of points, e.g. the speed of a joint.

            given "effort":  M v' = .. + J^T u,  y = J v;       "flow":  J v = u,  M v' = .. + J^T y

        `rate(at, speed)` gets the functions for positions and velocities of `points`, and is linear in the latter.
        """
        self.parts.rate_ports.append(RatePort(name, domain, given, tuple(points), rate, description))

    def rate_damper(self, points: Sequence[Point], rate: Rate, value: Any) -> None:
        """Dissipation |J v|^2 value of a rate; `value`: a number, a parameter, or value(d) as of `observable`."""
        self.parts.rate_dampers.append(RateDamper(tuple(points), rate, value))

    def rate_integral(
        self,
        name: str,
        points: Sequence[Point],
        rate: Rate,
        *,
        unit: str,
        start: float = 0.0,
        energy: Scalar | None = None,
    ) -> None:
        """A state s, s' = J(q) v, as an angle that counts turns, with `energy(s)` [J]: M v' = .. - J^T energy'(s)."""
        self.parts.integrals.append(RateIntegral(name, unit, float(start), tuple(points), rate, energy))

    # -- contacts ---------------------------------------------------------------------------------------------------

    def contact(
        self,
        name: str,
        gap: Callable[[Any], ca.SX],
        restitution: float = 0.0,
        *,
        nominal: float = 1.0,
        unit: str = "m",
    ) -> None:
        """A hard contact without friction, 0 <= gap: a state event `name` and the parameter `name.restitution` e.

            at gap = 0:  c = d gap/dt jumps to -e c,  M v+ = M v- + n m,  n = (d gap/dq)^T,  lost (1 - e^2)/2 c^2/(n^T M^-1 n)

        with the constraints kept through it; what it loses is booked.  `gap(d)` is made of d.at(point), and of d.integral[name]
        of `rate_integral`.

        A contact throws back and does not hold: what is to rest on something rests on a strain with a rate damper.
        Source: Brogliato, Nonsmooth Mechanics (2016), Newton's law of restitution.
        """
        e = parameter(f"{name}.restitution", float(restitution), min=0.0, max=1.0, description=f"of {name}")
        self.parts.parameters.append(e)
        self.parts.contacts.append(HardContact(name, gap, e, float(nominal), unit))

    def observable(self, name: str, unit: str, of: Callable[[Any], ca.SX], description: str = "") -> None:
        """A reported expression of(d) of d.at(point), d.speed(point) and d.multiplier[label]."""
        self.parts.reported.append(PositionObservable(name, unit, of, description))

    # -- pictures -----------------------------------------------------------------------------------------------------

    def solid(
        self, kind: ShapeKind | str, *points: Point, size: Sequence[float], axes: Sequence[Point] = (), label: str = ""
    ) -> None:
        """A solid that pictures show; it has no mass and no force.

        kind, points and size [m]: "ball" (centre; radius), "box" (centre; three edges along the axes), "cylinder" (centre;
        radius, length along the third axis), "rod" (both ends; radius).  axes: as many directors that turn it as there are
        dimensions, or none.
        """
        named = ShapeKind(kind)
        needed = {ShapeKind.BALL: (1, 1), ShapeKind.BOX: (1, 3), ShapeKind.CYLINDER: (1, 2), ShapeKind.ROD: (2, 1)}.get(
            named
        )
        if needed != (len(points), len(size)) or len(axes) not in (0, self.dim):
            raise ValueError(
                f"{self.name}: solid '{named}' with {len(points)} points, size {tuple(size)} and {len(axes)} axes: a ball has "
                "a centre and its radius, a box a centre and three edges, a cylinder a centre, radius and length, a rod two "
                f"ends and its radius; axes are {self.dim} directors, or none"
            )
        self.parts.solids.append(Solid(named, points, tuple(axes), tuple(map(float, size)), label or named.value))

    # -- the declaration --------------------------------------------------------------------------------------------

    def build(self) -> PHDAE:
        """The declaration, with states q and v, multipliers lambda in the order bars, constraints."""
        return Declaration(self.parts).phdae()

    def _sized(self, what: str, values: Sequence[Any]) -> None:
        if len(values) != self.dim:
            raise ValueError(f"{self.name}: {what} needs {self.dim} entries, got {len(values)}")

    def _at_rest(self, what: str, *points: Point) -> None:
        for p in points:
            if isinstance(p, MovingSupport):
                raise ValueError(
                    f"{self.name}: a {what} cannot end at the moving support '{p.name}', its energy would depend on time; "
                    "let it end at a driven_point, or at a particle of mass 0 led by a constraint"
                )

    def _not_driven(self, what: str, *points: Point) -> None:
        for p in points:
            if isinstance(p, DrivenPoint):
                raise ValueError(
                    f"{self.name}: {what} cannot end at the driven point '{p.name}': a jump of its input would be an impact; "
                    "use a moving_support, or put a spring between"
                )

    def _start(self, point: Point) -> Sequence[float]:
        if isinstance(point, Support):
            return point.position
        if isinstance(point, DrivenPoint):
            return point.q
        if isinstance(point, MovingSupport):
            expr = ca.vertcat(*map(ca.SX, point.position(time)))
            return [float(x) for x in ca.DM(ca.Function("s", [time], [expr])(0.0)).full().ravel()]
        if isinstance(point, Particle):
            return self.parts.masses[point.number].q
        raise ValueError(f"{self.name}: the length of a bar to a combined point is not known; give it")


def _label(point: Point) -> str:
    if isinstance(point, Particle):
        return f"particle {point.number + 1}"
    if isinstance(point, LinearCombination):
        return "a combined point"
    return f"support {point.position}" if isinstance(point, Support) else f"'{point.name}'"
