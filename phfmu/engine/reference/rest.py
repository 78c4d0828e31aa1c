"""Constraints at rest in Python: the readable twin of runtime/rest.c.

Of redundant rows of Dg as many as needed are left out, w = 0 in their place, so that the others are independent.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.reference.evaluate import Evaluator
from phfmu.engine.reference.newton import Fixed, StepNewton
from phfmu.outcome.limits import LIMITS

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SPARE = 1e-12  # of the largest singular value: what is left of a null vector whose rows exert no force


def called(evaluator: Evaluator) -> Flags:
    """Constraints at rest that are not redundant at the last residual."""
    return evaluator.rests & ~(evaluator.gap <= LIMITS["REST_GAP"] * evaluator.plan.hold.size)


def forces(newton: StepNewton, h: float) -> Array:
    """Size of the forces of a unit of each multiplier at each node (constraints x k)."""
    plan = newton.plan
    a = np.where(plan.matrix.row == plan.matrix.col, 0.0, newton.evaluator.matrix(h))
    return np.sqrt(np.bincount(plan.matrix.col, a**2, plan.nw))[_multipliers(newton)]


def spread(newton: StepNewton, w: Array, h: float) -> Array:
    """The unknowns with the multipliers of least norm: w + X t at each node, X null vectors of Dg^T, of least forces."""
    rows, d, out = _multipliers(newton), forces(newton, h), w.copy()
    for i, at in enumerate(rows.T):
        null = np.column_stack([_dependence(newton, r) for r in at[newton.evaluator.rests]])[at]
        t = np.linalg.lstsq(d[:, i : i + 1] * null, -d[:, i] * w[at], rcond=SPARE)[0]
        out[at] += null @ t
    return out


def evaluated(newton: StepNewton, rests: Flags, w: Array, fixed: Fixed) -> Array:
    """All rows at the solution w, its multipliers those of least norm where constraints rest."""
    evaluator = newton.evaluator
    if rests.any():
        newton.residual(w, fixed)  # null vectors of the matrix there, not of the one Newton was content with
        newton.bare = True
        newton.factor(fixed[3])
        w = spread(newton, w, fixed[3])
        evaluator.rests = np.zeros_like(rests)  # their rows are not looked at any more
    newton.residual(w, fixed)
    evaluator.rests = rests.copy()
    return w


def exchange(newton: StepNewton, w: Array, h: float) -> Flags | None:
    """Another constraint rests in place of one whose share in their dependence has become small; None if none has.

    Changes w along the dependence until it is 0 there.
    """
    hold, rests = newton.plan.hold, newton.evaluator.rests
    first, d = _multipliers(newton)[:, 0], forces(newton, h)[:, 0]
    most, pair = LIMITS["REST_SHARE"], None
    for r in np.flatnonzero(rests & (d > 0)):
        null = _dependence(newton, first[r])[first]
        share = np.where(rests, 0.0, np.abs(null) * d / d[r])
        if share.max() > most:
            most, pair = share.max(), (int(r), int(np.argmax(share)), null)
    if pair is None:
        return None
    old, new, null = pair
    for level in zip(*hold.rows, strict=True):
        w[list(level)] -= w[level[new]] / null[new] * null
    found = rests.copy()
    found[[old, new]] = False, True
    return found


def _multipliers(newton: StepNewton) -> NDArray[np.int64]:
    """Unknowns of the multipliers (constraints x k)."""
    return np.array([rows[: newton.plan.k] for rows in newton.plan.hold.rows])


def _dependence(newton: StepNewton, row: int) -> Array:
    """The null vector of Dg^T in which the constraint at rest with this row has a multiplier of 1."""
    return newton.solve(-np.eye(1, newton.plan.nw, row)[0])
