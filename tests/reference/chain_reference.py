"""A hanging chain of rigid links with dampers and bending springs, with the multipliers eliminated (index 1).

M v' = F(q, v) - Dg^T lambda,   Dg M^-1 Dg^T lambda = Dg M^-1 F + |v_i+1 - v_i|^2,   q' = v
"""

import numpy as np
from scipy.integrate import solve_ivp


def chain(stop, n=10, dim=3, length=1.0, mass=1.0, damping=0.0, bending=0.0, speed=0.0):
    """Return q (n x dim), v (n x dim) and lambda (n) at `stop`, from the straight horizontal start."""
    m = mass * (1.0 + np.arange(n) / max(n - 1, 1))
    q = np.zeros((n, dim))
    v = np.zeros((n, dim))
    q[:, 0], v[:, 1] = length * np.arange(1, n + 1), speed * np.arange(1, n + 1) / n
    rows = np.eye(n) - np.eye(n, k=-1)  # differences to the previous point

    def accelerate(q, v):
        d, u = rows @ q, rows @ v
        force = np.zeros((n, dim))
        force[:, -1] = -9.81 * m
        force -= damping * rows.T @ u
        full = np.vstack([np.zeros(dim), q])
        for i in range(n - 1):
            s = full[i + 2] - full[i]
            pull = 2 * bending * (s @ s - 4 * length**2) * s
            force[i + 1] -= pull
            if i:
                force[i - 1] += pull
        G = np.einsum("ij,ik->ijk", rows, d).reshape(n, n * dim)
        free = (force / m[:, None]).ravel()
        minv = np.repeat(1 / m, dim)
        lam = np.linalg.solve((G * minv) @ G.T, G @ free + (u**2).sum(axis=1))
        return (free - minv * (G.T @ lam)).reshape(n, dim), lam

    def rhs(_, y):
        q, v = y.reshape(2, n, dim)
        return np.concatenate([v.ravel(), accelerate(q, v)[0].ravel()])

    y = solve_ivp(rhs, (0, stop), np.concatenate([q.ravel(), v.ravel()]), "DOP853", rtol=3e-14, atol=1e-14).y[:, -1]
    q, v = y.reshape(2, n, dim)
    return q, v, accelerate(q, v)[1]
