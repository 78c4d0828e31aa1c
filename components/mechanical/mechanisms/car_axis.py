"""The car axis: two bodies on stiff springs over a wavy road."""

from __future__ import annotations

import casadi as ca

from phfmu import PHDAE, time
from phfmu.components.mechanical.multibody import Multibody


def car_axis(*, epsilon: float = 1e-2, mass: float = 10.0, amplitude: float = 0.1, omega: float = 10.0) -> PHDAE:
    """The chassis of a car between two wheels, of which the right one goes over a bump after the other.

        m = epsilon^2 mass/2;   springs of stiffness 1 and length 1/2 from each body to its wheel, gravity 1
        left wheel at 0, right one at (x_b, y_b),  y_b = amplitude sin(omega t),  x_b^2 + y_b^2 = 1
        0 = x_l x_b + y_l y_b  (the left body stands upright on the line of the wheels),   |r - l| = 1

    All numbers are without units, as published.  The springs are stiff beside the small masses: periods of 0.14.

    Arguments:    epsilon [1], mass [1];  amplitude [1] and omega [1] of the road
    Port:         road: work of the right wheel's motion
    Observables:  left (2), right (2): positions of the bodies
    Source:       F. Mazzia, C. Magherini, Test Set for Initial Value Problem Solvers (2008), problem "car axis", with the
                  solution at t = 3
    """
    body = Multibody("car_axis", 2, description="two bodies on stiff springs over a wavy road")
    m = 0.5 * epsilon**2 * mass
    k = body.parameter("k", 1.0, unit="N/m", min=0.0, description="stiffness of the springs").sx
    rest = body.parameter("rest", 0.5, unit="m", min=0.0, description="length of the springs, unloaded").sx
    width = body.parameter("width", 1.0, unit="m", positive=True, description="distance of the wheels").sx
    g = body.parameter("g", 1.0, unit="m/s2", min=0.0, description="gravity").sx
    bump = body.parameter("amplitude", amplitude, unit="m", description="amplitude of the road").sx
    rate = body.parameter("omega", omega, unit="rad/s", description="angular frequency of the road").sx
    left = body.particle(m, (0.0, 0.5), (-0.5, 0.0), name="left")
    right = body.particle(m, (1.0, 0.5), (-0.5, 0.0), name="right")
    wheel = body.particle(0.0, (1.0, 0.0), (0.0, amplitude * omega), weight=False, name="wheel")
    y = bump * ca.sin(rate * time)
    x = ca.sqrt(width**2 - y**2)
    body.potential(lambda at: m * g * (at(left)[1] + at(right)[1]))
    body.linear_spring(body.support((0.0, 0.0)), left, k, rest)
    body.linear_spring(wheel, right, k, rest)
    body.bar(left, right)
    body.constraint(lambda at: at(wheel) - ca.vertcat(x, y), "road", drive="road")
    body.constraint(lambda at: at(left)[0] * x + at(left)[1] * y, "upright", drive="road")
    for name, particle in (("left", left), ("right", right)):
        body.observable(name, "m", lambda d, p=particle: d.at(p), f"position of the {name} body")
    return body.build()
