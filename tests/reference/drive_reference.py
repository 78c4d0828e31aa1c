"""Permanent-magnet DC motor, flexible shaft and load inertia; linear, solved by the matrix exponential.

    L i'   = V - R i - k w1                          L = 2e-3 H, R = 0.4 ohm, k = 0.05 V s/rad, V = 12 V
    J w1'  = k i - d w1 - T                          J = 1e-4 kg m2, d = 1e-5 N m s/rad
    twist' = w1 - w2,   T = c twist + b (w1 - w2)    c = 20 N m/rad, b = 1e-3 N m s/rad
    Jl w2' = T - dl w2                               Jl = 5e-4 kg m2, dl = 2e-4 N m s/rad

From rest at t = 0. x' = A x + a is augmented to z' = [[A, a], [0, 0]] z, z = (x, 1), and z(t) = expm(t .) z(0).
States in the order i (A), w1 (rad/s), twist (rad), w2 (rad/s).
"""

import numpy as np
from reference_tools import RTOL, agreement, describe, grid, integrate, write
from scipy.linalg import expm

V, L, R, K = 12.0, 2e-3, 0.4, 0.05
J, D = 1e-4, 1e-5
C, B = 20.0, 1e-3
JL, DL = 5e-4, 2e-4
MATRIX = np.array(
    [
        [-R / L, -K / L, 0.0, 0.0, V / L],
        [K / J, -(D + B) / J, -C / J, B / J, 0.0],
        [0.0, 1.0, 0.0, -1.0, 0.0],
        [0.0, B / JL, C / JL, -(B + DL) / JL, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0],
    ]
)
TIMES = grid((0.0, 0.1, 0.005))
COLUMNS = ["i", "w1", "twist", "w2"]
GROUPS = {name: (slice(k, k + 1), "relative") for k, name in enumerate(COLUMNS)}


def solve(times=TIMES):
    """Return the exact states at `times` (rows)."""
    return np.array([expm(MATRIX * t)[:4, 4] for t in times])


def make(name="drive"):
    """Write drive.csv; return (path, errors)."""
    table = solve()
    check = integrate(
        ((np.inf, lambda t, z: MATRIX @ z),), [0, 0, 0, 0, 1.0], TIMES, [1.0, 1.0, 1e-3, 1.0, 1.0], max_step=1e-4
    )
    errors = agreement(table, check[:, :4], GROUPS)
    comments = [
        f"accuracy: expm against DOP853 rtol {RTOL:g} over all rows: {describe(errors, GROUPS)}",
        "drive: i in A, w1 w2 in rad/s, twist in rad; tests/reference/drive_reference.py",
    ]
    return write(name, comments, COLUMNS, TIMES, table), errors
