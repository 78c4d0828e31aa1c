"""Newton's method for the equations of an operating point."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.operating.system import NoOperatingPoint, Sparse, System, Triplets
from phfmu.words import first_few

Array = NDArray[np.float64]

ITERATIONS = 40
#: all unknowns rest: largest update relative to the largest value of the same variable, that of the start included: a machine
#: that delivers no power has a torque of 0
REST = 1e-13
#: below this, where the iteration is quadratic, an update that is no smaller than the one before is rounding
FLOOR = 1e-9
#: of its terms: what rounding leaves of an equation
ROUNDING = 1e-14
#: of the motion: the shortest step in s, how many times it doubles, iterations of one step
SHORTEST, LENGTHS, RELAXING = 1e-4, 26, 20


def solved(system: System) -> tuple[Array, int]:
    """The unknowns, and how many iterations it took: Newton's method with full steps, no damping.

    It begins with voltages whose angles one linear solution has given, since angles far from the flat ones lead it
    astray, as damping does.  Where it fails, as from machines without flux, the motion itself leads to the point: steps of
    the implicit Euler method in the rotating frame, of which each is twice as long as the one before.
    """
    start = _turned(system, np.array(system.start))
    try:
        return _newton(system, start)
    except NoOperatingPoint as failure:
        try:
            return _relaxed(system, start)
        except NoOperatingPoint:
            raise failure from None


def _newton(
    system: System, v: Array, most: int = ITERATIONS, motion: tuple[Sparse, Array] | None = None
) -> tuple[Array, int]:
    """Newton's method from v; `motion`: a matrix D and the values v0 before, for F + D (v - v0) = 0."""
    group = np.unique(system.named, return_inverse=True)[1]
    start, pinned, begun, before = v, None, np.abs(system.start), np.inf
    evaluated = system.evaluate(v)
    for iteration in range(1, most + 1):
        F, J = evaluated
        if pinned is None:
            pinned = _pinned(system, J, group)
        if motion is not None:
            F, J = F + motion[0] @ (v - motion[1]), J + motion[0]
        try:
            update = solution(J + pinned, F, J)
        except RuntimeError as failure:
            raise _failed(system, "its equations are singular", v, F, J) from failure
        v = v - update
        if not np.isfinite(v).all():
            raise _failed(system, "Newton's method left the numbers", start, F, J)
        size = np.zeros(group.max() + 1)
        np.maximum.at(size, group, np.maximum(np.abs(v), begun))
        moved = float((np.abs(update) / np.maximum(size[group], 1e-300)).max())
        if moved <= REST or before <= moved <= FLOOR:
            return v, iteration
        evaluated = system.evaluate(v)
        if motion is None and _at_rounding(system, v, *evaluated):
            return v, iteration
        before = moved
    raise _failed(system, f"Newton's method did not converge in {most} iterations", v, F, J)


def _at_rounding(system: System, v: Array, F: Array, J: Sparse) -> bool:
    return bool((np.abs(F) <= ROUNDING * (abs(J) @ np.abs(v) + np.abs(system.offset)) + 1e-300).all())


def _relaxed(system: System, v: Array) -> tuple[Array, int]:
    """The point that the motion in the rotating frame comes to: (x - x0)/h = f - w (S x + c) with longer and longer h."""
    taken = 0
    for h in SHORTEST * 2.0 ** np.arange(LENGTHS):
        motion = Triplets()
        for row, place, n in system.rates:
            motion.eye(row, place, n, -1.0 / h)
        v, more = _newton(system, v, RELAXING, (motion.matrix((system.rows, len(v))), v))
        taken += more
    v, more = _newton(system, v)
    return v, taken + more


def _turned(system: System, v: Array) -> Array:
    """The start with the angles of the voltages by one linear solution, and states of members turned with them.

    In it members with specifications are currents that meet these, all others are as they are: the power flow
    linearised at flat voltages, of which only the angles are taken.
    """
    _, J = system.evaluate(v)
    rows, columns = system.linear()
    if len(rows) != len(columns) or not any(s.sets_power for s in system.specifications):
        return v
    F, _ = system.evaluate(v)
    A = (J + _pinned(system, J, np.unique(system.named, return_inverse=True)[1])).tocsr()[rows][:, columns]
    try:
        update = solution(A, F[rows])
    except RuntimeError:
        return v
    moved, out = v.copy(), v.copy()
    moved[columns] -= update
    angles: dict[str, float] = {}
    for junction, (at, _) in system.common.items():
        if not system.turns[junction]:
            continue
        before, after = complex(*v[at : at + 2]), complex(*moved[at : at + 2])
        angle = angles[junction] = ((after - before) / before).imag if before else 0.0
        turned = before * complex(np.cos(angle), np.sin(angle))
        out[at : at + 2] = turned.real, turned.imag
    first = system.first_junctions()
    for kind in system.kinds.values():
        moving = [m for m in kind.members if first.get(m) in angles]
        A, b = kind.equations.turns([angles[first[m]] for m in moving])
        places = np.array([system.state_at[m] for m in moving], int)[:, None] + np.arange(kind.equations.size.x)
        out[places] = (A @ v[places][:, :, None])[:, :, 0] + b
    return out


def _pinned(system: System, J: Sparse, group: Any) -> Sparse:
    """Ones where a direction of a member's variables that no equation sees meets a sum of its rows that has no entries.

    Such is the zero sequence of parts without resistance: it keeps its start value.  The scales are the same
    for the three phases, in which the zero sequence is orthogonal to what turns.
    """
    magnitude, entries = np.zeros(group.max() + 1), J.tocoo()
    np.maximum.at(magnitude, group[entries.col], np.abs(entries.data))
    import scipy.sparse as sp

    column = 1.0 / np.maximum(magnitude[group], 1e-300)
    N = (J @ sp.diags(column)).tocsr()
    largest = _largest(N, 1)
    row = 1.0 / np.where(largest == 0, 1.0, largest)
    N = (sp.diags(row) @ N).tocsr()
    by_column, pins = N.tocsc(), Triplets()
    for name, e in system.kind_of.items():
        n, at, first = e.size.x + e.size.a, system.state_at[name], system.row_of[name]
        unseen = _null(by_column, at, n)
        if not unseen.shape[1]:
            continue
        empty = _null(N, first, n)
        if empty.shape[1] != unseen.shape[1]:
            raise NoOperatingPoint(
                f"{name}: {unseen.shape[1]} directions of its variables are not determined, and {empty.shape[1]} sums of its "
                "equations are empty; give what fixes them (a resistance, a value for an input)"
            )
        pins.block(first, at, (empty @ unseen.T) / row[first : first + n, None] / column[at : at + n])
    return pins.matrix(J.shape)


def _failed(system: System, what: str, v: Array, F: Array, J: Sparse) -> NoOperatingPoint:
    size = abs(J) @ np.abs(v) + np.abs(system.offset)
    worst = np.argsort(-np.abs(F) / np.where(size > 0, size, np.inf))[:3]
    names = first_few(sorted({system.named[int(abs(J[int(r)]).argmax())] for r in worst}))
    return NoOperatingPoint(
        f"{system.net.name}: no operating point was found, {what}; it stands out at {names}. Check the specifications, and "
        "that powers can flow at these voltages; begin nearer to the solution (start values), or with less power"
    )


def solution(A: Sparse, b: Array, scaled: Sparse | None = None) -> Array:
    """x of A x = b, with the scales of `scaled` (A); RuntimeError: A is singular."""
    import scipy.sparse as sp
    from scipy.sparse.linalg import splu

    row, column = _equilibrated(A if scaled is None else scaled)
    return column * splu((sp.diags(row) @ A @ sp.diags(column)).tocsc()).solve(row * b)


def _equilibrated(J: Sparse) -> tuple[Array, Array]:
    """Scales of rows and columns, by two rounds of Ruiz."""
    import scipy.sparse as sp

    column = _largest(J, 0)
    column = 1.0 / np.where(column == 0, 1.0, column)
    row = _largest(J @ sp.diags(column), 1)
    row = 1.0 / np.where(row == 0, 1.0, row)
    for _ in range(2):
        M = sp.diags(row) @ J @ sp.diags(column)
        by_column, by_row = (np.sqrt(_largest(M, axis)) for axis in (0, 1))
        column, row = column / np.where(by_column == 0, 1.0, by_column), row / np.where(by_row == 0, 1.0, by_row)
    return row, column


def _largest(M: Sparse, axis: int) -> Array:
    """The largest magnitude of each column (axis 0) or row (axis 1)."""
    return abs(M).max(axis=axis).toarray().ravel()


def _null(matrix: Sparse, first: int, n: int) -> Array:
    """Orthonormal combinations of n columns (of a CSC matrix; rows of a CSR one) from `first` on that are zero."""
    ptr = matrix.indptr[first : first + n + 1]
    used, row = np.unique(matrix.indices[ptr[0] : ptr[-1]], return_inverse=True)
    strip = np.zeros((len(used), n))
    strip[row, np.repeat(np.arange(n), np.diff(ptr))] = matrix.data[ptr[0] : ptr[-1]]
    _, s, V = np.linalg.svd(strip)
    s = np.concatenate([s, np.zeros(V.shape[0] - len(s))])
    return V.T[:, s < 1e-12 * max(float(s.max(initial=0.0)), 1e-300)]
