"""Newton's method of a plan from a given start in Python: the readable twin of runtime/newton.c, with the same tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.reference.evaluate import Evaluator
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import Status
from phfmu.plan.plan import Ints

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

Array = NDArray[np.float64]
Fixed = tuple[Array, Array, Array, float]  # fixed values of a solve: x, [u | h], p, h

EPS = float(np.finfo(float).eps)
TOLERANCE, ROUNDING, STAGNATION = LIMITS["TOLERANCE"], LIMITS["ROUNDING"], LIMITS["STAGNATION"]
SAME_UPDATE = LIMITS["SAME_UPDATE"]
CRAWLING, CRAWL, SHRINKING = LIMITS["CRAWLING"], LIMITS["CRAWL"], LIMITS["SHRINKING"]
WANDERING = LIMITS["WANDERING"]
STALLS, GROWN, FLOOR, SUMS = LIMITS["STALLS"], LIMITS["GROWN"], LIMITS["FLOOR"], LIMITS["CONSTRAINT_SUMS"]
DELTA, DELTA_PART, DEPENDENT = LIMITS["DELTA"], LIMITS["DELTA_PART"], LIMITS["DEPENDENT"]
LEAST_DAMPING, ITERATIONS = LIMITS["LEAST_DAMPING"], int(LIMITS["NEWTON_ITERATIONS"])
#: up to so many unknowns a full matrix is factored faster than a sparse one
FULL = 128


@dataclass
class Outcome:
    """Result of one attempt: status, unknowns, iterations, worst scaled residual, its row and floor, last update norm.

    `moved`: the norm of the last update without multipliers of constraints.
    """

    status: Status
    w: Array
    iterations: int = 0
    residual: float = 0.0
    row: int = -1
    update: float = 0.0
    floor: float = 0.0
    moved: float = 0.0


@cache
def _lapack() -> list[Callable[..., Any]]:
    """Factor, and solve with factors."""
    from scipy.linalg import get_lapack_funcs

    return get_lapack_funcs(("getrf", "getrs"), dtype=np.float64)


class StepNewton:
    """Solves R[0:nw](w) = 0 for one plan."""

    def __init__(self, evaluator: Evaluator):
        self.evaluator = evaluator
        self.plan = evaluator.plan
        self._factors: Callable[[Array], Array] | None = None
        self._scale = np.ones(self.plan.nw)
        #: factors without delta where there are pivots, see `ways`
        self.bare = False

    @cached_property
    def _multipliers(self) -> Ints:
        """Multipliers of constraints that may lose rank."""
        return self.plan.hold.of(np.ones(len(self.plan.hold), bool))

    @property
    def _loses_rank(self) -> bool:
        """True if constraints may lose rank beside masses that move by more than the rounding of forces.

        Beside vanishing ones the multipliers are what moves them.
        """
        return len(self.plan.hold) > 0 and not self.plan.hold.vanishing

    @property
    def ways(self) -> tuple[tuple[bool, bool], ...]:
        """Attempts to make in turn: `bare`, and whether to start without the last forces of constraints.

        Where there are constraints factors have no delta, so again without these forces, then with delta.

        Near a loss of rank, and beside light masses, delta is as large as what is left of the constraints, and Newton's
        method crawls; where pivots are lost to rounding it leads past them.  Beside vanishing masses it comes first: without
        it their motion is that of the rounding of forces.
        """
        if not len(self.plan.hold):
            return ((False, False),)
        bare, delta = ((True, False), (True, True)), ((False, False),)
        return delta + bare if self.plan.hold.vanishing else bare + delta

    def free(self, w: Array) -> Array:
        """w without forces of constraints, for a start.

        Near a loss of rank those of the last step may be as large as those of this one, and opposite.  As they enter
        linearly, Newton's method does not need them.
        """
        w = w.copy()
        w[self._multipliers] = 0.0
        return w

    def residual(self, w: Array, fixed: Fixed) -> Array:
        """Rows [0, nw) at w; `fixed` = (x, [u | h], p, h)."""
        x, tail, p, h = fixed
        return self.evaluator.residual(x, np.concatenate([w, tail]), p, h)[: self.plan.nw]

    def factor(self, h: float) -> bool:
        """Factor the row-scaled matrix at the current slots; False if singular."""
        plan = self.plan
        a = self.evaluator.matrix(h)
        biggest = np.zeros(plan.nw)
        np.maximum.at(biggest, plan.matrix.row, np.abs(a))
        if not np.isfinite(biggest).all():
            return False
        self._scale = 1.0 / np.where(biggest > 0, biggest, 1.0)
        a = a * self._scale[plan.matrix.row]
        return self.bare and self._split(a) or self._split(a + self._delta(a))

    def _delta(self, a: Array) -> Array:
        """Lambda enters as h: delta must not grow beside the Schur complement; a column without entries gets all of it."""
        plan = self.plan
        columns = np.maximum.reduceat(np.abs(a), plan.colptr[:-1])[plan.matrix.row[plan.regularised]]
        delta = np.zeros(len(a))
        delta[plan.regularised] = np.where(columns > 0, np.minimum(DELTA, DELTA_PART * columns), DELTA)
        return delta

    @cached_property
    def _sparse(self) -> csc_matrix:
        """A matrix of the plan's pattern, whose entries are set anew: its checks cost more than small factors."""
        from scipy.sparse import csc_matrix

        plan = self.plan
        return csc_matrix((np.zeros(plan.matrix.nnz), plan.matrix.row, plan.colptr), shape=(plan.nw, plan.nw))

    def _split(self, a: Array) -> bool:
        """LU of the matrix with entries a; False if a column cancels to rounding: it depends on the others."""
        pivots = self._split_full(a) if 0 < self.plan.nw <= FULL else self._split_sparse(a)
        if pivots is None:
            return False
        original = np.maximum.reduceat(np.abs(a), self.plan.colptr[:-1])
        return bool((np.abs(pivots) > DEPENDENT * EPS * original).all())

    def _split_full(self, a: Array) -> Array | None:
        """Pivots of the columns, by LAPACK; None if singular."""
        getrf, getrs = _lapack()
        m, n = self.plan.matrix, self.plan.nw
        full = np.zeros((n, n), order="F")
        full[m.row, m.col] = a
        lu, pivots, singular = getrf(full, overwrite_a=True)
        self._factors = lambda r: getrs(lu, pivots, r)[0]
        return None if singular else lu.diagonal()

    def _split_sparse(self, a: Array) -> Array | None:
        """Pivots of the columns, by SuperLU; None if singular."""
        from scipy.sparse.linalg import splu

        self._sparse.data[:] = a
        try:
            lu = splu(self._sparse)
        except RuntimeError:
            return None
        self._factors = lu.solve
        return lu.U.diagonal()[lu.perm_c]

    def solve(self, r: Array) -> Array:
        """The Newton correction -A^-1 r with the last factor."""
        assert self._factors is not None
        return -self._factors(self._scale * r)

    def refined(self, r: Array, h: float) -> Array:
        """-A^-1 r, with one refinement that takes out the delta of the factor."""
        m, dw = self.plan.matrix, self.solve(r)
        return dw + self.solve(r + np.bincount(m.row, self.evaluator.matrix(h) * dw[m.col], self.plan.nw))

    def attempt(self, w: Array, fixed: Fixed, damped: bool) -> Outcome:
        """Solve by Newton's method from w.

        With delta it may end where updates crawl along what delta is as large as, with rows at their floors and no better:
        from there it goes on without, and what it finds is taken.
        """
        found = self._iterated(w, fixed, damped)
        hold = self.plan.hold
        if found.status is not Status.OK or self.bare or not len(hold) or hold.vanishing or found.update <= TOLERANCE:
            return found
        self.bare = True
        better = self._iterated(found.w, fixed, False)
        if better.status is Status.OK:
            return better
        self.bare = False
        return found

    def _iterated(self, w: Array, fixed: Fixed, damped: bool) -> Outcome:
        """Iterate from w until rounding, then polish once with the old factor."""
        plan, h = self.plan, fixed[3]
        w, last, least, stalls, wanders, grew = w.copy(), np.inf, np.inf, 0, 0, False
        w[self.evaluator.resting] = 0.0
        out = Outcome(Status.NO_CONVERGENCE, w)
        r = self.residual(w, fixed)
        for i in range(ITERATIONS):
            out.iterations = i + 1
            if not np.isfinite(r).all():
                return self._failed(out, Status.NOT_FINITE, r, fixed)
            if not self.factor(h):
                return self._failed(out, Status.SINGULAR, r, fixed)
            dw = self.solve(r)
            if not np.isfinite(dw).all():
                return self._failed(out, Status.NOT_FINITE, r, fixed)
            before, damping = r, self._damping(w, dw, r, fixed) if damped else 1.0
            if not damping:
                return self._failed(out, Status.NO_CONVERGENCE, r, fixed)
            w = w + damping * dw
            r = self.residual(w, fixed)
            size = np.abs(dw) / (plan.nominal + np.abs(w))
            out.w, out.update = w, float(np.max(size, initial=0.0))
            size[self._multipliers] = 0.0
            out.moved = float(np.max(size, initial=0.0))
            grew |= last < out.update > TOLERANCE
            stalls = stalls + 1 if SHRINKING * last < out.update <= GROWN * last else 0
            wanders = 0 if out.update < least else wanders + 1
            least = min(least, out.update)
            if damping == 1.0 and self._solved(out, last, grew, stalls, wanders, before, fixed):
                if not np.isfinite(r).all():
                    return self._failed(out, Status.NOT_FINITE, r, fixed)
                out.w = w + self.solve(r)
                out.status = Status.OK
                return out
            last = out.update
        return self._failed(out, Status.NO_CONVERGENCE, r, fixed)

    def _solved(self, out: Outcome, last: float, grew: bool, stalls: int, wanders: int, r: Array, fixed: Fixed) -> bool:
        """True if one polish reaches rounding.

        Two updates tell what is left after it;  once one grew, as stiff and free directions take turns, both must be small.
        Two in a row that hardly shrink (stalls) are at the floor if the residual r before the last is rounding, or if they
        are tiny and only noise is left; so are many of which none is the smallest yet (wanders), where constraints nearly
        lose rank.  There multipliers are known as badly as the forces in the lost directions are small, and do not count.
        """
        if out.update == 0.0:
            return True
        ratio = out.update / last
        if out.update <= TOLERANCE and (not grew or last <= TOLERANCE) and ratio**2 * out.update <= ROUNDING:
            return True
        crawls = CRAWL < ratio < 1.0
        if (out.moved if self._loses_rank else out.update) > (CRAWLING if crawls else STAGNATION):
            return False
        if wanders >= WANDERING:
            return self._at_floor(out.w, r, fixed, float(self._loses_rank))
        if ratio <= SHRINKING:
            return False
        noise = ratio >= 1.0 - SAME_UPDATE and out.update <= TOLERANCE
        return stalls >= STALLS and (noise or self._at_floor(out.w, r, fixed, float(crawls or self._loses_rank)))

    def _at_floor(self, w: Array, r: Array, fixed: Fixed, nominal: float = 0.0) -> bool:
        """All rows are rounding."""
        size = self._rounding(w, fixed, nominal)
        size[self.plan.matrix.row[self.plan.regularised]] *= SUMS
        return bool((np.abs(r) <= FLOOR * size).all())

    def _rounding(self, w: Array, fixed: Fixed, nominal: float = 0.0) -> Array:
        """Rounding of each row: eps sum_j |A_ij| (|w_j| + |x_j|), x_j the state whose increment w_j is.

        nominal = 1 judges rows by the nominal size of their unknowns too, all of a model whose constraints may lose rank,
        else those of multipliers: there the noise of others reaches rows in which all is zero, and multipliers crawl
        without end for less.
        """
        plan, x, h = self.plan, fixed[0], fixed[3]
        size = np.bincount(plan.update_w, np.abs(x[plan.update_x]), plan.nw) + np.abs(w)
        part = np.full(plan.nw, nominal if self._loses_rank else 0.0)
        part[plan.matrix.row[plan.regularised]] = nominal
        column = np.repeat(np.arange(plan.nw), np.diff(plan.colptr))
        a = np.abs(self.evaluator.matrix(h))
        with np.errstate(invalid="ignore"):  # of a trial that ran away nothing counts as rounding
            terms = a * (size[column] + part[plan.matrix.row] * plan.nominal[column])
        return np.finfo(float).eps * np.bincount(plan.matrix.row, terms, plan.nw)

    def _damping(self, w: Array, dw: Array, r: Array, fixed: Fixed) -> float:
        """The longest of the steps 1, 1/2, .. 1/64 that reduces the scaled residual, at rounding the full one; 0 if none does."""
        if self._at_floor(w, r, fixed):
            return 1.0
        base = np.linalg.norm(self._scale * r)
        step = 1.0
        while step >= LEAST_DAMPING:
            if np.linalg.norm(self._scale * self.residual(w + step * dw, fixed)) < base:
                return step
            step /= 2
        return 0.0

    def _failed(self, out: Outcome, status: Status, r: Array, fixed: Fixed) -> Outcome:
        scaled = np.abs(self._scale * r)
        out.status = status
        out.row = int(np.argmax(np.where(np.isfinite(scaled), scaled, np.inf))) if scaled.size else -1
        if scaled.size:
            out.residual = float(scaled[out.row])
            out.floor = float(self._scale[out.row] * self._rounding(out.w, fixed)[out.row])
        return out
