"""The reference engine: an instance stepped in Python, one statement of the method after the other."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.discretise.model import Model
from phfmu.engine import rest, rest_start
from phfmu.engine.attempts import Attempts
from phfmu.engine.evaluate import Evaluator
from phfmu.engine.limits import LIMITS
from phfmu.engine.newton import Fixed, Newton, Outcome
from phfmu.engine.rest_changes import RestChange, named
from phfmu.engine.state import State
from phfmu.engine.status import Status, StepFailure

Array = NDArray[Any]

DEPTH = 6  # halvings of a step before it is given up


class PythonInstance:
    """A component a master can step; see `NativeInstance` for the fast twin with the same methods.

    Inputs u (nu) are held over a step.  `output()` gives the step-conjugate means, so that h u^T y is the supplied
    energy exactly.  StepFailure leaves the instance at its last accepted step.
    """

    def __init__(self, model: Model):
        self.model = model
        self._step, self._instant = Evaluator(model.step), Evaluator(model.instant)
        self._newton, self._solver = Newton(self._step), Newton(self._instant)
        self._begun = self._most = 0.0  # of the iterations: at the start of the internal step, at most in all
        self.reset()

    # -- state ------------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Back to the start values; the algebraic variables are solved for the start."""
        self._s = State.at_start(self.model)
        self.initialise()

    def initialise(self) -> None:
        """Solve the instant system; step means take their instantaneous values."""
        s, plan = self._s, self.model.step
        s.end = None
        end = self._end_values()
        s.a = end["a"].copy()
        s.y_step, s.y_node = end["y"].copy(), np.tile(end["y"], (plan.k, 1))
        s.w = np.zeros(plan.nw)
        level = plan.increments[plan.mean_w] == 0
        s.w[plan.mean_w[level]] = s.a[plan.mean_a[level]]
        s.h_last = 0.0
        s.last = self._nothing()

    def _nothing(self) -> dict[str, Array]:
        """The ledger of a step in which nothing moved."""
        plan = self.model.step
        sums = {n: np.zeros(plan.ncomp) for n in ("stored", "dissipated", "supplied", "numerical", "moved")}
        return sums | {"pairs": np.zeros(plan.nq)}

    def get_state(self) -> State:
        """A complete copy; stepping after `set_state` gives the same bits."""
        return copy.deepcopy(self._s)

    def set_state(self, state: State) -> None:
        self._s = copy.deepcopy(state)

    def set_input(self, u: ArrayLike) -> None:
        """Inputs (nu), held over the next steps."""
        self._s.u = np.tile(self._array(u, self.model.step.nu), self.model.step.k)
        self._s.theta, self._s.end = 0.0, None

    def set_node_inputs(self, u: ArrayLike) -> None:
        """Inputs at the k quadrature nodes of the next step (k x nu)."""
        self._s.u = self._array(u, self.model.step.k, self.model.step.nu).ravel().copy()
        self._s.theta, self._s.end = 0.0, None

    def set_parameters(self, p: ArrayLike) -> None:
        self._s.p = self._array(p, self.model.step.np).copy()
        self._s.placed, self._s.end = True, None

    @property
    def parameters(self) -> Array:
        return self._s.p.copy()

    def set_x(self, t: float, x: ArrayLike) -> None:
        """Place the state; call `initialise` afterwards."""
        self._array([t], 1)
        self._s.x[:-1], self._s.x[-1], self._s.t = self._array(x, self.model.step.nx), t, t
        self._s.carry[:] = 0.0
        self._s.placed, self._s.end = True, None

    def continue_from(self, other: PythonInstance) -> None:
        """Go on from the state, time, held inputs, parameters and cumulative energies of `other`.

        `other` is of the same declaration under another scheme.
        """
        mine, its = self.model.step, other.model.step
        sizes = ("nx", "nu", "np", "nq", "na", "ncomp")
        held = other._s.u.reshape(its.k, -1)
        if any(getattr(mine, n) != getattr(its, n) for n in sizes) or (held != held[:1]).any():
            raise StepFailure(Status.ARGUMENT, self.model.name, other.time, 0.0)
        old, s = self._s, other.get_state()
        s.y_node = np.zeros((mine.k, mine.nq))
        s.u, s.w, s.h_last, s.counts, s.solved = np.tile(held[0], mine.k), old.w.copy(), old.h_last, old.counts, 0
        if old.t != s.t:  # its own last step is no longer the one before the next
            level = mine.increments[mine.mean_w] == 0
            s.w[mine.mean_w[level]], s.h_last = s.a[mine.mean_a[level]], 0.0
        if len(s.rests) != len(old.rests):
            s.rests, s.placed = old.rests, True
        self._s = s

    # -- stepping ---------------------------------------------------------------------------------------------------

    def do_step(self, t: float, h: float, parts: int = 1) -> None:
        """One communication step over [t, t + h] in `parts` equal internal steps.

        h < 0 goes back in time: the schemes are symmetric, so a step and the same step back give the old state
        to rounding.  h = 0 leaves the state as it is, books nothing, and gives the means their values at t.
        A sliver, what rounding leaves of a master's clock, books nothing and keeps state and means: |h| up to two
        rounding units of t or 1e-9 of the last internal step.
        """
        if not (np.isfinite(t + h) and parts >= 1):
            raise StepFailure(Status.ARGUMENT, self.model.name, t, h)
        if h != 0 and self._is_sliver(t, h):
            self._skip(t + h)
            return
        self._choose_rests()
        before = self.get_state()
        if h == 0:
            self._stay(t, before)
            return
        s, plan = self._s, self.model.step
        s.x[-1] = t
        s.x_old, s.u_old, s.solved, s.parts = self._old().copy(), s.u.copy(), 0, parts
        s.last = self._nothing()
        y, a, nodes_y = np.zeros(plan.nq), np.zeros(plan.na), np.zeros((plan.k, plan.nq))
        self._most = s.counts["iterations"] + LIMITS["MOST_ITERATIONS"] + parts * LIMITS["MORE_ITERATIONS"]
        try:
            for i in range(parts):
                self._begun = s.counts["iterations"]
                for y_part, a_part, start, weight in self._advance(t, h, i / parts, 1.0 / parts, 0):
                    y += weight * (plan.weights @ y_part)
                    a += weight * a_part
                    nodes_y += self._projected(y_part, start, weight)
        except StepFailure:
            counts = self._s.counts
            self._s = before
            self._s.counts = counts
            raise
        s.y_step, s.y_node, s.t, s.theta = y, nodes_y, t + h, 1.0
        if not plan.carries:
            s.a = a
        s.x[-1] = t + h
        s.energy += s.last["pairs"]
        s.stored += s.last["stored"]
        s.dissipated += s.last["dissipated"]
        s.supplied += s.last["supplied"]
        s.counts["steps"] += 1
        s.end = None

    def _is_sliver(self, t: float, h: float) -> bool:
        clock = LIMITS["SLIVER_CLOCK"] * np.finfo(float).eps * abs(t)
        return abs(h) <= max(clock, LIMITS["SLIVER_STEP"] * abs(self._s.h_last))

    def _skip(self, t: float) -> None:
        """To the time t in a step too short to be one."""
        s = self._s
        s.x[-1], s.t, s.end, s.last = t, t, None, self._nothing()
        s.counts["steps"] += 1

    def _stay(self, t: float, before: State) -> None:
        """The step of length zero; its means are their limits for h -> 0."""
        s = self._s
        s.x[-1], s.t, s.end = t, t, None
        try:
            end = self._end_values()
        except StepFailure:
            self._s = before
            raise
        if not self.model.step.carries:
            s.a = end["a"].copy()
        s.x_old, s.u_old, s.solved, s.last = self._old().copy(), s.u.copy(), 0, self._nothing()
        s.y_step, s.y_node = end["y"].copy(), np.tile(end["y"], (self.model.step.k, 1))
        s.counts["steps"] += 1

    def _advance(
        self, t: float, h: float, start: float, part: float, depth: int
    ) -> list[tuple[Array, Array, float, float]]:
        """The part [start, start + part] of the step [t, t + h]: (node outputs, mean algebraics, start, part) per solve."""
        s = self._s
        s.x[-1] = t + h * start
        u = self._inputs(start + part * self.model.nodes)
        outcome = self._solve(h * part, u)
        energies = self._weigh(outcome, h * part, u) if outcome.status is Status.OK else {}
        if outcome.status is Status.OK:
            return [(*self._accept(outcome, h * part, energies), start, part)]
        spent = int(s.counts["iterations"] - self._begun)
        if depth == DEPTH or self._left() <= 0:
            name = self.model.row_names[outcome.row] if outcome.row >= 0 else ""
            raise StepFailure(
                outcome.status, self.model.name, t + h * start, h * part, equation=name, residual=outcome.residual,
                floor=outcome.floor, update=outcome.update, iterations=outcome.iterations, spent=spent,
                tried=f"two starts, shorter steps, line search and {2**DEPTH} substeps",
            )  # fmt: skip
        s.counts["substeps"] += 1
        first = self._advance(t, h, start, part / 2, depth + 1)
        return first + self._advance(t, h, start + part / 2, part / 2, depth + 1)

    def _old(self) -> Array:
        """What the kernels of a step read as x: states, time and, where they are carried, algebraic variables."""
        return np.append(self._s.x, self._s.a) if self.model.step.carries else self._s.x

    def _inputs(self, at: Array, old: bool = False) -> Array:
        """The polynomial through the node inputs of the communication step, at the fractions `at` of it (stacked).

        `old`: of the last step, whatever was set since.
        """
        k, u = self.model.step.k, self._s.u_old if old else self._s.u
        if k == 1 or not u.size:
            return np.tile(u, len(at)) if k == 1 else np.zeros(0)
        values, basis = u.reshape(k, -1), self.model.scheme.nodes
        if (values == values[0]).all():
            return np.tile(values[0], len(at))
        return np.concatenate([basis.value(float(c)) @ values for c in at])

    def _left(self) -> int:
        """Newton iterations the present internal step may still take."""
        most = min(self._begun + LIMITS["MOST_ITERATIONS"], self._most)
        return int(most) - self._s.counts["iterations"]

    def _solve(self, h: float, u: Array) -> Outcome:
        """Unknowns of a step of length h; constraints at rest that turn out not to be redundant come back."""
        s, evaluator = self._s, self._step
        evaluator.rests = s.rests.copy()
        s.counts["solves"] += 1
        while True:
            outcome = self._attempted(h, u)
            called = rest.called(evaluator)
            if outcome.status is not Status.OK or not called.any():
                break
            evaluator.rests &= ~called
        if outcome.status is Status.OK:
            s.counts["woken"] += int(np.sum(s.rests & ~evaluator.rests))
            s.change_rest(evaluator.rests, s.x[-1] + h)
        return outcome

    def _attempted(self, h: float, u: Array) -> Outcome:
        s, x = self._s, self._old()
        attempts = Attempts(
            self._newton, s.w, s.h_last, lambda length: (x, np.append(u, length), s.p, length), self._left()
        )
        outcome = attempts.solve(h)
        for name in ("iterations", "restarts", "line_searches"):
            s.counts[name] += getattr(attempts, name)
        return outcome

    def _weigh(self, outcome: Outcome, h: float, u: Array) -> dict[str, Array]:
        """Energies and node outputs of a solved part; the outcome fails if they, or the sums they go into, overflow."""
        s, plan = self._s, self.model.step
        fixed = (self._old(), np.append(u, h), s.p, h)
        with np.errstate(over="ignore", invalid="ignore"):
            w = self._evaluated(self._newton, outcome.w, fixed)
            stored, moved, lost, numerical = self._step.ledger(fixed[0], s.p)
            y_nodes = self._step.R[plan.nw : plan.nw + plan.nq * plan.k].reshape(plan.k, plan.nq)
            u_nodes = self._step.Y[plan.pair_src].reshape(plan.k, plan.nq)
            pairs = h * plan.weights @ (y_nodes * u_nodes)
            np.add.at(pairs, plan.work_pair, self._step.R[plan.work_row])
            part = {"stored": stored, "dissipated": h * lost, "numerical": numerical, "moved": moved, "pairs": pairs}
            part |= {"supplied": np.bincount(plan.pair_owner, pairs, plan.ncomp), "y": y_nodes.copy(), "w": w}
            sums = (s.x[:-1], s.energy, s.stored, s.dissipated, s.supplied, *part.values())
            if not all((np.abs(v) <= LIMITS["LARGEST"]).all() for v in sums):
                outcome.status, outcome.row = Status.NOT_FINITE, -1
        return part

    def _accept(self, outcome: Outcome, h: float, part: dict[str, Array]) -> tuple[Array, Array]:
        """Book the ledger at the converged unknowns and move the state; node outputs and mean algebraic variables."""
        s, plan = self._s, self.model.step
        s.solved += 1
        for name, row in s.last.items():
            row += part[name]
        s.w, s.h_last = outcome.w.copy(), h
        change = np.bincount(plan.update_x, plan.update_c * outcome.w[plan.update_w], plan.nx) + s.carry
        total = s.x[:-1] + change
        s.carry = change - (total - s.x[:-1])
        s.x[:-1] = total
        a = np.bincount(plan.mean_a, plan.mean_c * h**plan.mean_pow * part["w"][plan.mean_w], plan.na)
        if plan.carries:
            s.a = a
        if s.rests.any():
            self._exchange(h)
        return part["y"], a

    def _evaluated(self, newton: Newton, w: Array, fixed: Fixed) -> Array:
        """All rows at the solution w, its multipliers those of least norm where constraints rest."""
        evaluator, rests = newton.evaluator, self._s.rests
        if rests.any():
            newton.residual(w, fixed)  # null vectors of the matrix there, not of the one Newton was content with
            newton.bare = True
            newton.factor(fixed[3])
            w = rest.spread(newton, w, fixed[3])
            evaluator.rests = np.zeros_like(rests)  # their rows are not looked at any more
        newton.residual(w, fixed)
        evaluator.rests = rests.copy()
        return w

    def _exchange(self, h: float) -> None:
        """Another constraint rests where one has lost its share."""
        s = self._s
        found = rest.exchange(self._newton, s.w, h)
        if found is not None:
            s.change_rest(found, s.x[-1] + h)
            s.counts["exchanged"] += 1

    def _projected(self, y: Array, start: float, part: float) -> Array:
        """Outputs y (k x nq) at the nodes of a part of the step, as outputs at the nodes of the whole step.

        y_i = part sum_m (b_m / b_i) l_i(start + part c_m) y_m is conjugate to inputs u(t) = sum_i l_i(t) u_i.
        """
        plan = self.model.step
        if part == 1.0 or plan.k == 1:
            return part * y
        basis = np.array([self.model.scheme.nodes.value(start + part * float(c)) for c in self.model.nodes])
        return part * (basis * plan.weights[:, None] / plan.weights).T @ y

    def run(
        self,
        t0: float,
        h: float,
        n: int,
        record: Iterable[str] = (),
        inputs: ArrayLike | None = None,
        parts: int = 1,
        first: int = 0,
    ) -> dict[str, Array]:
        """Steps k = first..first+n-1 from t0 + k h; arguments and results as in `NativeInstance.run`."""
        rows: dict[str, list[Array]] = {name: [] for name in record}
        held = None if inputs is None else np.asarray(inputs, float)
        if held is not None and held.shape != (n, self.model.step.nu):
            raise ValueError(f"{self.model.name}: expected values of shape {(n, self.model.step.nu)}, got {held.shape}")
        for k in range(n):
            if held is not None:
                self.set_input(held[k])
            try:
                now = self._stepped(t0 + (first + k) * h, h, parts, reads=bool({"signals", "energy"} & rows.keys()))
            except StepFailure as failure:
                failure.recorded = {name: np.array(kept) for name, kept in rows.items()}
                raise
            now |= {"unknowns": self._s.w, "x": self.x, "a": self._s.a, "y_step": self._s.y_step}
            for name, kept in rows.items():
                kept.append(now[name].copy())
        return {name: np.array(kept) for name, kept in rows.items()}

    def _stepped(self, t: float, h: float, parts: int, reads: bool) -> dict[str, Array]:
        """A step and what is recorded of it; one whose end values are read and do not exist is not taken."""
        before, earlier = self.get_state() if reads else self._s, self.counts
        self.do_step(t, h, parts)
        spent = [float(self.counts[name] - earlier[name]) for name in ("iterations", "solves")]
        now = self.ledger() | {"counts": np.array(spent)}
        if not reads:
            return now
        try:
            signals = self.signals()
        except StepFailure:
            before.counts = self._s.counts | {"steps": before.counts["steps"]}
            self._s = before
            raise
        return now | {"signals": np.concatenate([signals[b] for b in self.layout]), "energy": signals["H"]}

    @property
    def layout(self) -> dict[str, slice]:
        """Place of each block in a row of recorded signals."""
        place, start = {}, 0
        for name, values in self.signals().items():
            place[name] = slice(start, start + len(values))
            start += len(values)
        return place

    # -- reading ----------------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        return self._s.t

    @property
    def x(self) -> Array:
        return self._s.x[:-1].copy()

    @property
    def counts(self) -> dict[str, int]:
        """steps, solves, iterations, restarts, line_searches, substeps since the reset."""
        return dict(self._s.counts)

    @property
    def rest_changes(self) -> list[RestChange]:
        """Which redundant constraints rest instead of which others, the last changes since the start."""
        return named(self._s.changes, self.model.hold_names)

    def output(self) -> Array:
        """Step-conjugate means of the external pairs (nu)."""
        return self._s.y_step[: self.model.step.nu].copy()

    def node_output(self) -> Array:
        """Outputs at the k quadrature nodes (k x nu): h sum_i b_i u_i^T y_i is the supplied energy of the last step."""
        return self._s.y_node[:, : self.model.step.nu].copy()

    def ledger(self) -> dict[str, Array]:
        """Of the last communication step: stored, dissipated, supplied, numerical, moved per component, pairs per pair [J]."""
        return {k: v.copy() for k, v in self._s.last.items()}

    @property
    def unknowns(self) -> Array:
        """w of the last solve: see `Plan`."""
        return self._s.w.copy()

    def signals(self) -> dict[str, Array]:
        """All values by block: x, time, a, y_step, energy, supplied, dissipated, residual, a_end, y_end, observables, H."""
        s, end = self._s, self._end_values()
        return {
            "x": s.x[:-1].copy(), "time": s.x[-1:].copy(), "a": s.a.copy(), "y_step": s.y_step.copy(), "energy": s.energy.copy(),
            "supplied": s.supplied.copy(), "dissipated": s.dissipated.copy(),
            "residual": s.stored + s.dissipated - s.supplied, "a_end": end["a"].copy(), "y_end": end["y"].copy(),
            "observables": end["o"].copy(), "H": end["H"].copy(),
        }  # fmt: skip

    def signal(self, block: str) -> Array:
        """One block of `signals`."""
        return self.signals()[block]

    def _end_values(self) -> dict[str, Array]:
        """Solve the instant system for the present state (cached until something changes)."""
        s, plan = self._s, self.model.instant
        if s.end is None:
            self._choose_rests()
            self._instant.rests = s.rests.copy()
            w, fixed = self._instant_start()
            if plan.nw:
                outcome = self._at_instant(w, fixed)
                if outcome.status is not Status.OK:
                    name = self.model.instant_names[outcome.row] if outcome.row >= 0 else ""
                    raise StepFailure(outcome.status, self.model.name, s.t, 0.0, equation=name,
                                      residual=outcome.residual, iterations=outcome.iterations)  # fmt: skip
                w = outcome.w
            a, r = self._evaluated(self._solver, w, fixed), self._instant.R
            stored, *_ = self._instant.ledger(s.x, s.p)
            if not np.isfinite(np.concatenate([r, stored])).all():
                raise StepFailure(Status.NOT_FINITE, self.model.name, s.t, 0.0)
            s.end = {
                "w": w, "a": a[plan.mean_w], "y": r[plan.nw : plan.nw + plan.nq].copy(),
                "o": r[plan.nw + plan.nq :].copy(), "H": stored,
            }  # fmt: skip
        return s.end

    def _instant_start(self) -> tuple[Array, Fixed]:
        """Where the instant system starts from, and what is fixed in it."""
        s, plan = self._s, self.model.instant
        w = np.zeros(plan.nw)
        w[plan.mean_w] = s.a[plan.mean_a]
        return w, (s.x, np.append(self._inputs(np.array([s.theta])), 1.0), s.p, 1.0)

    def _choose_rests(self) -> None:
        """Which constraints rest at a state or with parameters that were set."""
        s = self._s
        if s.placed and len(self.model.instant.hold):
            s.change_rest(rest_start.chosen(self._solver, *self._instant_start()), s.x[-1])
        s.placed = False

    def _at_instant(self, w: Array, fixed: tuple[Array, Array, Array, float]) -> Outcome:
        """The solution of the instant system from w, with line search where it takes one."""
        outcome = Outcome(Status.NO_CONVERGENCE, w)
        for damped in (False, True):
            for bare in self._solver.bare_too(damped):
                self._solver.bare = bare
                outcome = self._solver.attempt(w, fixed, damped)
                if outcome.status is Status.OK:
                    return outcome
        return outcome

    def sensitivity(self, end: bool = False) -> Array:
        """S = d(mean external outputs)/d(held inputs) of the last step (nu x nu): implicit function theorem.

        Internal steps are chained.  `end`: of the outputs at the present time instead.  StepFailure NO_SENSITIVITY where one
        was halved.
        """
        s = self._s
        if end:
            w = self._end_values()["w"]
            u = self._inputs(np.array([s.theta]))
            return self._derivative(self._solver, w, (s.x, np.append(u, 1.0), s.p, 1.0))
        if s.solved != 1:
            found = self._chained() if s.solved == s.parts > 1 else None
            if found is None:
                raise StepFailure(Status.NO_SENSITIVITY, self.model.name, s.t, s.h_last)
            return found
        return self._derivative(self._newton, s.w, (s.x_old, np.append(s.u_old, s.h_last), s.p, s.h_last))

    def _chained(self) -> Array | None:
        from phfmu.engine.chain import chained

        return chained(self._newton, self._s, lambda start, part: self._inputs(start + part * self.model.nodes, True))

    def _derivative(self, newton: Newton, w: Array, fixed: tuple[Array, Array, Array, float]) -> Array:
        """D - C A^-1 B at w, one refinement against the regularisation of the factor."""
        plan, d = newton.plan, newton.plan.derivative
        nw, nu = plan.nw, plan.nu
        newton.evaluator.rests = self._s.rests.copy()
        newton.residual(w, fixed)
        full = np.zeros((nw + nu, nw + nu))
        np.add.at(full, (d.row, d.col), newton.evaluator.products(d, fixed[3]))
        if nw == 0 or nu == 0:
            return full[nw:, nw:]
        newton.factor(fixed[3])
        a = np.zeros((nw, nw))
        a[plan.matrix.row, plan.matrix.col] = newton.evaluator.matrix(fixed[3])
        dw = np.column_stack([newton.solve(b) for b in full[:nw, nw:].T])
        dw += np.column_stack([newton.solve(b) for b in (full[:nw, nw:] + a @ dw).T])
        return full[nw:, nw:] + full[nw:, :nw] @ dw

    def _array(self, values: ArrayLike, *shape: int) -> Array:
        array = np.asarray(values, float)
        if array.shape != shape:
            raise ValueError(f"{self.model.name}: expected values of shape {shape}, got {array.shape}")
        if not np.isfinite(array).all():
            raise StepFailure(Status.VALUE, self.model.name, self._s.t if hasattr(self, "_s") else 0.0, 0.0)
        return array
