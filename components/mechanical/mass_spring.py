"""Two masses and two springs in three redundant coordinates: a singular mass matrix."""

from __future__ import annotations

import casadi as ca

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Holonomic,
    Port,
    algebraic,
    damping,
    energy,
    parameter,
    reduce_descriptor,
    skew,
    state,
)


def mass_spring(
    *,
    m1: float = 1.0,
    m2: float = 0.5,
    k1: float = 40.0,
    k2: float = 25.0,
    d1: float = 0.0,
    d2: float = 0.0,
    l10: float = 0.4,
    w: float = 0.1,
    elongations: tuple[float, float] = (0.1, -0.05),
    speeds: tuple[float, float] = (0.0, 0.0),
    reduced: bool = True,
) -> PHDAE:
    """Two masses in line: wall, spring 1, mass 1 of width w, spring 2, mass 2, with E = diag(I, M, 0) singular.

        H = 1/2 m1 v1^2 + 1/2 m2 (v2 + v3)^2 + 1/2 k1 x1^2 + 1/2 k2 x2^2,   q = (x1, q2, x2),   q' = v,
        M v' = -(k1 x1 + d1 v1, 0, k2 x2 + d2 v3) - Dg^T lambda + (0, F, F),
        M = [[m1, 0, 0], [0, m2, m2], [0, m2, m2]],   0 = Dg v,   g = q2 - x1 - l10 - w

    x1, x2: elongations of the springs; q2: where spring 2 starts.  Reduced to semi-explicit form (index 1):

        v = V (v.differential, v.algebraic),   V = [[1, 0, 0], [0, a, a], [0, a, -a]],   a = 1/sqrt(2),
        Sigma1 = diag(m1, 2 m2);   the row of v.algebraic gives lambda, the row of lambda gives v.algebraic

    `reduced=False`: the form above, which can be transformed but not stepped, with states q, v and multiplier lambda.

    States:      q [m] (3), v.differential [m/s] (2);  algebraic: lambda [N], v.algebraic [m/s];  v is reported
    At start:    `elongations` [m] (2), `speeds` [m/s] (2)
    Ports:       tip (force on mass 2 given, its velocity out)
    Parameters:  m1, m2 [kg]; k1, k2 [N/m]; d1, d2 [N.s/m]; l10 (length of spring 1 at rest), w [m]
    Source:      Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, Example 7 and appendix E (dampers and port added)
    """
    x1, x2 = elongations
    q = state("q", 3, unit="m", start=(x1, x1 + l10 + w, x2), description="elongation, position, elongation")
    v = state("v", 3, unit="m/s", start=(speeds[0], speeds[0], speeds[1]), description="their rates")
    multiplier = algebraic("lambda", unit="N", description="force at the connection")
    m1s, m2s = parameter("m1", m1, unit="kg"), parameter("m2", m2, unit="kg")
    k1s, k2s = parameter("k1", k1, unit="N/m"), parameter("k2", k2, unit="N/m")
    d1s, d2s = parameter("d1", d1, unit="N.s/m"), parameter("d2", d2, unit="N.s/m")
    length, width = parameter("l10", l10, unit="m"), parameter("w", w, unit="m")
    descriptor = PHDAE(
        "mass_spring",
        states=(q, v),
        algebraics=(multiplier,),
        parameters=(m1s, m2s, k1s, k2s, d1s, d2s, length, width),
        energies=tuple(energy(0.5 * c * x**2) for c, x in ((m1s, v[0]), (m2s, v[1] + v[2]), (k1s, q[0]), (k2s, q[2]))),
        E={v: ca.diagcat(m1s.sx, ca.repmat(m2s.sx, 2, 2))},
        z={v: v.sx},
        structure=(skew(q, v, 1.0),),
        dissipation=(damping(v, ca.vertcat(d1s.sx, 0.0, d2s.sx)),),
        ports=(Port("tip", TRANSLATIONAL, "effort", {v: [0.0, 1.0, 1.0]}, description="force on mass 2"),),
        constraints=(Holonomic(multiplier, q[1] - q[0] - length - width),),
        description="two masses and two springs in three coordinates, singular mass matrix",
    )
    return reduce_descriptor(descriptor) if reduced else descriptor
