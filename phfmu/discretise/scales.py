"""Natural size of hidden constraints, against which a start is called consistent."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.variable import time
from phfmu.terms.hidden import Check
from phfmu.terms.rows import check_rows
from phfmu.terms.term import Terms

Array = NDArray[np.float64]


def check_scales(terms: Terms, checks: list[Check], x0: Array, p0: Array) -> Array:
    """Natural size of each check: the sum over states of |d check / d x| times the larger of nominal and start."""
    if not checks:
        return np.zeros(0)
    model = terms.model
    nominal = np.array([v.nominal[j] for v in model.states for j in range(v.n)])
    size = np.maximum(nominal, np.abs(x0))
    parameters = ca.vertcat(*(p.sx for p in model.parameters))
    rows = check_rows(terms, checks)
    jac = ca.Function("j", [model.x, parameters, time], [ca.jacobian(ca.vertcat(*rows), model.x)])
    sizes = ca.fabs(jac(x0, p0, 0.0)) @ size  # sparse: rows x states would not fit for large models
    return np.array(sizes).ravel() + 1e-300
