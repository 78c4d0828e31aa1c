"""Four particles, two springs, a damper and two rigid bars, as an ODE (notes/seedref.md 1; damped case).

    M v' = -grad V(q) - R(q) v - Dg(q)^T lambda,    q' = v,    g(q) = 0
    V   = k13/2 (|q3 - q1|^2 - 1)^2 + k24/2 (|q4 - q2|^2 - 1)^2,   k13 = 50, k24 = 500
    g   = ((|q2 - q1|^2 - 1)/2, (|q4 - q3|^2 - 1)/2)
    R v = eta (0, v2 - v3, v3 - v2, 0),   eta = eta0 (1 + alpha |q3 - q2|^2),   eta0 = 1, alpha = 0.5
    M   = diag(1, 3, 2.3, 1.7) (kron I3);   q0 = (0,0,0), (1,0,0), (0,1,0), (1,1,0);   v4 = (0, 0, 20/17), else 0

lambda follows from the hidden constraint d/dt (Dg v) = 0:

    Dg M^-1 Dg^T lambda = Dg M^-1 (-grad V - R v) + (|v2 - v1|^2, |v4 - v3|^2)

so lambda(0) = (0, 23/17), not the lambda0 = 0 of the published input files.
Source: Kinon, Morandin, Schulze, Appl. Num. Math. 2026, Sec. 6.3.
"""

import numpy as np
from reference_tools import agreement, describe, grid, integrate, names, write

RTOL, STEP, STEP_CHECK = 2.5e-14, 5e-4, 2e-3  # the stiff spring: steps limited, so that rounding decides

MASS = np.repeat([1.0, 3.0, 2.3, 1.7], 3)
K13, K24, ETA0, ALPHA = 50.0, 500.0, 1.0, 0.5
Q0 = np.array([0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0], dtype=float)
V0 = np.array([0.0] * 11 + [20.0 / 17.0])
TIMES = grid(0.0, 0.1, 0.5, 1.0)
COLUMNS = names("q", 12) + names("v", 12) + names("lambda", 2)
GROUPS = {"q": (slice(0, 12), "absolute"), "v": (slice(12, 24), "absolute"), "lambda": (slice(24, 26), "absolute")}


def constraint(q):
    """Return g (2) and Dg (2 x 12)."""
    r = q.reshape(4, 3)
    bars = r[1] - r[0], r[3] - r[2]
    jacobian = np.zeros((2, 4, 3))
    for row, (i, bar) in enumerate(zip((0, 2), bars, strict=False)):
        jacobian[row, i], jacobian[row, i + 1] = -bar, bar
    return np.array([(bar @ bar - 1.0) / 2.0 for bar in bars]), jacobian.reshape(2, 12)


def energy(q, v):
    """Return H = 1/2 v^T M v + V(q)."""
    r = q.reshape(4, 3)
    stretch = [(d @ d - 1.0) ** 2 for d in (r[2] - r[0], r[3] - r[1])]
    return 0.5 * v @ (MASS * v) + 0.5 * (K13 * stretch[0] + K24 * stretch[1])


def accelerate(q, v):
    """Return v' and lambda."""
    r, u = q.reshape(4, 3), v.reshape(4, 3)
    force = np.zeros((4, 3))
    for k, i, j in ((K13, 0, 2), (K24, 1, 3)):
        d = r[j] - r[i]
        pull = 2.0 * k * (d @ d - 1.0) * d
        force[i] += pull
        force[j] -= pull
    d = r[2] - r[1]
    drag = ETA0 * (1.0 + ALPHA * (d @ d)) * (u[1] - u[2])
    force[1] -= drag
    force[2] += drag
    _, jacobian = constraint(q)
    bars = u[1] - u[0], u[3] - u[2]
    free = force.ravel() / MASS
    multiplier = np.linalg.solve(jacobian / MASS @ jacobian.T, jacobian @ free + [w @ w for w in bars])
    return free - jacobian.T @ multiplier / MASS, multiplier


def solve(max_step=STEP, times=TIMES):
    """Return the published table (rows: times; columns: COLUMNS) for steps of at most max_step."""

    def rhs(t, y):
        return np.concatenate([y[12:], accelerate(y[:12], y[12:])[0]])

    states = integrate(((np.inf, rhs),), np.concatenate([Q0, V0]), times, np.ones(24), RTOL, max_step=max_step)
    return np.array([np.concatenate([y, accelerate(y[:12], y[12:])[1]]) for y in states])


def make(name="four_particle"):
    """Write four_particle.csv; return (path, errors)."""
    table = solve()
    errors = agreement(table, solve(STEP_CHECK), GROUPS)
    drift = [np.max(np.abs(np.concatenate([constraint(y[:12])[0], constraint(y[:12])[1] @ y[12:24]]))) for y in table]
    comments = [
        f"accuracy: DOP853 rtol {RTOL:g}, steps <= {STEP:g} against <= {STEP_CHECK:g} over all rows: "
        f"{describe(errors, GROUPS)}; "
        f"constraint drift max(|g|, |Dg v|) {max(drift):.1e}",
        f"{name}: alpha 0.5, eta0 1; M v' = -grad V - R v - Dg^T lambda; tests/reference/four_particle_reference.py",
    ]
    return write(name, comments, COLUMNS, TIMES, table), errors
