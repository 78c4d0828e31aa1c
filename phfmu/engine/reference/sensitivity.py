"""The sensitivity of one solve, by the implicit function theorem."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.reference.newton import Fixed, StepNewton
from phfmu.engine.reference.rest import Flags

Array = NDArray[Any]


def derivative(newton: StepNewton, rests: Flags, w: Array, fixed: Fixed) -> Array:
    """D - C A^-1 B at the solution w (nu x nu), one refinement against the regularisation of the factor."""
    plan, d = newton.plan, newton.plan.derivative
    nw, nu = plan.nw, plan.nu
    newton.evaluator.rests = rests.copy()
    newton.residual(w, fixed)
    full = np.zeros((nw + nu, nw + nu))
    np.add.at(full, (d.row, d.col), newton.evaluator.products(d, fixed[3]))
    if nw == 0 or nu == 0:
        return full[nw:, nw:]
    newton.factor(fixed[3])
    dw = np.column_stack([newton.refined(b, fixed[3]) for b in full[:nw, nw:].T])
    return full[nw:, nw:] + full[nw:, :nw] @ dw
