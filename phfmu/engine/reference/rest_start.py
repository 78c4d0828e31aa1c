"""Choice of the constraints that rest at a state or with parameters that were set: the readable twin of runtime/rest_start.c.

The plan's, but not those that are needed there, and those that depend on the others there.  From the matrix of the
instant system, whose columns are the forces of the multipliers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.reference.newton import Fixed, StepNewton
from phfmu.engine.reference.rest import Flags, forces
from phfmu.outcome.limits import LIMITS

Array = NDArray[np.float64]


def chosen(newton: StepNewton, w: Array, fixed: Fixed) -> Flags:
    """The constraints that rest; those of the plan where the matrix has no factor."""
    plan, evaluator = newton.plan.hold.rests, newton.evaluator
    evaluator.rests = plan.copy()
    found = _taken(newton, w, fixed, bare=False)
    while found and (c := _dependent(newton)) is not None:
        evaluator.rests[c] = True
        found = _taken(newton, w, fixed, bare=False)
    return evaluator.rests.copy() if found and _revised(newton, w, fixed) else plan.copy()


def _taken(newton: StepNewton, w: Array, fixed: Fixed, bare: bool) -> bool:
    """True if there is a factor, bare or with delta, where these constraints rest; those without a force do."""
    evaluator, before = newton.evaluator, None
    while before is None or (evaluator.rests != before).any():
        before = evaluator.rests.copy()
        newton.residual(w, fixed)
        evaluator.rests |= forces(newton, 1.0)[:, 0] == 0.0
    newton.bare = bare
    return newton.factor(1.0)


def _columns(newton: StepNewton) -> tuple[Array, NDArray[np.int64]]:
    """Forces of a unit of each multiplier (nw x constraints), and where the multipliers are."""
    plan = newton.plan
    first = np.array([rows[0] for rows in plan.hold.rows])
    place = np.full(plan.nw, -1)
    place[first] = np.arange(len(first))
    at = place[plan.matrix.col]
    used = (at >= 0) & (plan.matrix.row != plan.matrix.col)
    out = np.zeros((plan.nw, len(first)))
    out[plan.matrix.row[used], at[used]] = newton.evaluator.matrix(1.0)[used]
    return out, first


def _dependent(newton: StepNewton) -> int | None:
    """A constraint that depends on others that do not rest either, the one with the largest force in their dependence.

    Inverse iteration from weights that do not cancel.
    """
    columns, first = _columns(newton)
    size = np.linalg.norm(columns, axis=0)
    awake = ~newton.evaluator.rests & (size > 0)
    push = size * (1.0 + (0.6180339887498949 * np.arange(len(first))) % 1.0)
    x = np.zeros(len(first))
    for _ in range(int(LIMITS["REST_ROUNDS"])):
        b = np.zeros(newton.plan.nw)
        b[first] = np.where(awake, push, 0.0)
        x = newton.solve(-b)[first]
        most = np.max(np.abs(x) * size, initial=0.0)
        if not most > 0.0:
            return None
        push = size * (size * x / most)
    return _whose(x, size) if np.linalg.norm(columns @ x) <= LIMITS["REST_CANCELLED"] * most else None


def _whose(x: Array, size: Array) -> int:
    """The last constraint with the largest force."""
    force = np.abs(x) * size
    return int(np.flatnonzero(force > (1.0 - LIMITS["REST_EQUAL"]) * force.max())[-1])


def _revised(newton: StepNewton, w: Array, fixed: Fixed) -> bool:
    """Lets those that rest and are needed come back, and those with larger forces in a dependence rest instead."""
    found = _taken(newton, w, fixed, bare=True)
    for _ in range(len(newton.plan.hold) + 1):
        if not found or not _revision(newton):
            break
        found = _taken(newton, w, fixed, bare=True)
    return found


def _revision(newton: StepNewton) -> bool:
    """The first change that `_revised` makes, if any."""
    rests = newton.evaluator.rests
    columns, first = _columns(newton)
    size = np.linalg.norm(columns, axis=0)
    for c in np.flatnonzero(rests & (size > 0)):
        x = newton.solve(-np.eye(1, newton.plan.nw, first[c])[0])[first] / size[c]
        most = np.max(np.abs(x) * size)
        needed = np.linalg.norm(columns @ x) > LIMITS["REST_CANCELLED"] * most
        if not needed and most <= LIMITS["REST_SHARE"]:
            continue
        rests[c] = False
        if not needed:
            rests[_whose(x, size)] = True
        return True
    return False
