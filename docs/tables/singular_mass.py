"""Table of docs/results/transformations.md: a singular mass matrix against two degrees of freedom."""

from __future__ import annotations

import numpy as np
from pages import PageBlock, slopes, table
from scipy.linalg import expm

from phfmu import Collocated, PythonInstance, build_model
from phfmu.components.mechanical.mass_spring import mass_spring

M1, M2, K1, K2, D1, D2, FORCE, END = 1.3, 0.5, 40.0, 25.0, 0.6, 0.4, 1.7, 0.8


def two_degrees_of_freedom() -> np.ndarray:
    """(s1, s2, s1', s2') at END by the matrix exponential of m1 s1'' = f2 - f1, m2 s2'' = F - f2."""
    A = np.zeros((5, 5))
    A[0, 2] = A[1, 3] = 1.0
    A[2, :4] = [-(K1 + K2) / M1, K2 / M1, -(D1 + D2) / M1, D2 / M1]
    A[3, :4] = [K2 / M2, -K2 / M2, D2 / M2, -D2 / M2]
    A[3, 4] = FORCE / M2
    return expm(A * END)[:4] @ [0.1, 0.05, 0.3, -0.5, 1.0]


def mass_spring_orders() -> PageBlock:
    """Two masses with a singular mass matrix, reduced: largest error of positions and speeds, and the balance."""
    exact, rows = two_degrees_of_freedom(), []
    declaration = mass_spring(m1=M1, m2=M2, k1=K1, k2=K2, d1=D1, d2=D2, elongations=(0.1, -0.05), speeds=(0.3, -0.8))
    for k in (1, 2, 3):
        model, steps, errors, worst, drift = build_model(declaration, Collocated(k)), (10, 20, 40), [], [], []
        for n in steps:
            names = ("x", "stored", "dissipated", "supplied")
            r = PythonInstance(model).run(0.0, END / n, n, names, inputs=[[FORCE]] * n)
            x = r["x"][-1]
            errors.append(float(np.abs([x[0], x[0] + x[2], x[3], np.sqrt(2) * x[4]] - exact).max()))
            size = sum(np.abs(r[name]).sum() for name in names[1:])
            worst.append(float(np.abs(r["stored"] + r["dissipated"] - r["supplied"]).max() / size))
            drift.append(float(np.abs(r["x"][:, 1] - r["x"][:, 0] - 0.5).max()))
        for i, s in enumerate(slopes(errors, [END / n for n in steps])):
            head = f"order {2 * k}" if i == 0 else ""
            rows.append([head, f"{END / steps[i]:g}", errors[i], s, worst[i], drift[i]])
    return table(["scheme", "h in s", "error", "slope", "worst balance", "largest g in m"], rows)
