"""The four-particle system of Kinon, Morandin and Schulze (2026), section 6.3."""

from __future__ import annotations

import casadi as ca

from phfmu import PHDAE, Holonomic, algebraic, block, energy, parameter, skew, state, strain_energy

PAIRS = {"bar": ((0, 1), (2, 3)), "spring": ((0, 2), (1, 3)), "damper": (1, 2)}


def four_particle(*, alpha: float = 0.5, eta0: float = 1.0) -> PHDAE:
    """Four particles in space, two rigid bars, two quartic springs and a state-dependent damper.

        H = 1/2 v^T M v + k13/2 (|q3 - q1|^2 - 1)^2 + k24/2 (|q4 - q2|^2 - 1)^2,
        q' = v,   M v' = -DV - R(q) v - Dg^T lambda,   0 = Dg v,   g = (|d|^2 - 1)/2 for the bars 1-2 and 3-4.

    R acts on the full relative velocity of particles 2 and 3 with eta = eta0 (1 + alpha |q3 - q2|^2).

    States:      q [m] (12), v [m/s] (12);  multipliers lambda [N/m] (2)
    Parameters:  m [kg] (4), k13, k24 [N/m3], eta0 [N.s/m], alpha [1/m2]
    Source:      Appl. Numer. Math. 2026, section 6.3 (all numbers)
    """
    q0 = [0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0]
    q = state("q", 12, unit="m", start=q0, description="positions of the particles")
    v = state("v", 12, unit="m/s", start=[0.0] * 11 + [20.0 / 17.0], description="velocities of the particles")
    lam = algebraic("lambda", 2, unit="N/m", description="multipliers of the bars, step means")
    m = parameter("m", [1.0, 3.0, 2.3, 1.7], 4, unit="kg", description="masses")
    k13 = parameter("k13", 50.0, unit="N/m3", description="spring between particles 1 and 3")
    k24 = parameter("k24", 500.0, unit="N/m3", description="spring between particles 2 and 4")
    eta = parameter("eta0", eta0, unit="N.s/m", description="damping at zero distance")
    al = parameter("alpha", alpha, unit="1/m2", description="growth of the damping with the squared distance")

    def at(x: ca.SX, i: int) -> ca.SX:
        return x[3 * i : 3 * i + 3]

    def squared(i: int, j: int) -> ca.SX:
        return ca.sumsqr(at(q.sx, j) - at(q.sx, i))

    mass = ca.vertcat(*(m[i] for i in range(4) for _ in range(3)))
    kinetic = [energy(0.5 * m[i] * ca.sumsqr(at(v.sx, i))) for i in range(4)]
    springs = [
        strain_energy(squared(i, j), lambda s, k=k: 0.5 * k.sx * (s - 1.0) ** 2)
        for (i, j), k in zip(PAIRS["spring"], (k13, k24), strict=True)
    ]
    i, j = PAIRS["damper"]
    eta_now = eta * (1.0 + al * squared(i, j))
    part = ca.kron(ca.SX([[1, -1], [-1, 1]]), ca.SX.eye(3)) * eta_now
    damper = ca.SX(12, 12)
    rows = list(range(3 * i, 3 * i + 3)) + list(range(3 * j, 3 * j + 3))
    damper[rows, rows] = part
    return PHDAE(
        "four_particle",
        states=(q, v),
        algebraics=(lam,),
        parameters=(m, k13, k24, eta, al),
        energies=(*kinetic, *springs),
        E={v: mass},
        structure=(skew(q, v, 1.0),),
        dissipation=(block([v], damper),),
        constraints=(Holonomic(lam, ca.vertcat(*(0.5 * (squared(a, b) - 1.0) for a, b in PAIRS["bar"]))),),
        description="four particles, two bars, two quartic springs, one damper (index 2)",
    )
