"""Models and step sizes of the gradient pair and the Dirac-dissipative scheme."""

from __future__ import annotations

import numpy as np

from phfmu import (
    PHDAE,
    DiracDissipative,
    GradientPair,
    PythonInstance,
)
from phfmu.components.electrical import synchronous_machine
from phfmu.components.library import build
from tests.schemes.test_orders import G, rlc


def steps(model, h, n, engine=PythonInstance):
    """x and a after every step (rows), and the worst step residual over H at the start and the energies exchanged."""
    instance, x, a, worst = engine(model), [], [], 0.0
    stored = np.sum(np.abs(instance.signal("H")))
    for k in range(n):
        instance.do_step(k * h, h)
        row = instance.ledger()
        size = stored + sum(np.sum(np.abs(row[name])) for name in ("dissipated", "supplied"))
        left = np.sum(row["stored"] + row["dissipated"] - row["supplied"])
        worst = max(worst, abs(left) / size)
        x.append(instance.x)
        a.append(instance.signal("a"))
    return np.array(x), np.array(a), worst


H = 0.1


def current(v):
    roots = np.roots([0.5, 0.0, G, -v])
    return float(roots[np.argmin(np.abs(roots.imag))].real)


def declaration(name):
    if name == "rlc":
        return rlc("source", "algebraic")
    if name == "machine":
        return synchronous_machine(coordinates="abc-flux")
    found = build(name)
    return found if isinstance(found, PHDAE) else found.declaration()


BOTH = [GradientPair(), DiracDissipative()]
