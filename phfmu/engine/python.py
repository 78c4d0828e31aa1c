"""The reference engine: an instance stepped in Python, one statement of the method after the other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.discretise.model import Model
from phfmu.engine.event_step import require_no_events, told
from phfmu.engine.inputs import carried
from phfmu.engine.landing import landed
from phfmu.engine.limits import LIMITS
from phfmu.engine.model import require_built, require_one_mode
from phfmu.engine.python_readings import PythonReadings
from phfmu.engine.state import State
from phfmu.engine.status import Status, StepFailure
from phfmu.engine.steps import balance
from phfmu.events.happened import Happened, Landed
from phfmu.terms.port_impulses import PortImpulse

Array = NDArray[Any]


class PythonInstance(PythonReadings):
    """A component a master can step; see `NativeInstance` for the fast twin with the same methods.

    Inputs u (nu) are held over a step.  `output()` gives the step-conjugate means, so that h u^T y is the supplied
    energy exactly.  StepFailure leaves the instance at its last accepted step.
    """

    def __init__(self, model: Model):
        require_built(model, "PythonInstance")
        require_one_mode(model)
        super().__init__(model)
        #: state events of the last `do_step` or `run`
        self.happened: tuple[Happened, ...] = ()
        self.initialise()

    # -- state ------------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        """Back to the start values; the algebraic variables are solved for the start."""
        self._s = State.at_start(self.model)
        self.initialise()

    def initialise(self) -> None:
        """Solve the instant system; step means take their instantaneous values."""
        s, plan = self._s, self.model.step
        s.end = None
        end = self._present.values(self._s)
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
        return self._s.copy()

    def set_state(self, state: State) -> None:
        self._s = state.copy()

    def restore(self, state: Any) -> None:
        """`set_state`; the counts of what the solver did go on."""
        counts = self._s.counts
        self.set_state(state)
        self._s.counts = counts | {"steps": state.counts["steps"]}

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

    @property
    def held_input(self) -> Array:
        """Inputs (nu) as they were set, held."""
        return self._s.u[: self.model.step.nu].copy()

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
        s.impulses = old.impulses
        s.u, s.w, s.h_last, s.counts, s.path = np.tile(held[0], mine.k), old.w.copy(), old.h_last, old.counts, []
        if old.t != s.t:  # its own last step is no longer the one before the next
            level = mine.increments[mine.mean_w] == 0
            s.w[mine.mean_w[level]], s.h_last = s.a[mine.mean_a[level]], 0.0
        if len(s.rests) != len(old.rests):
            s.rests, s.placed = old.rests, True
        self._s = s

    @property
    def impulse_ports(self) -> tuple[PortImpulse, ...]:
        """What each external port does with impulses, and why not more."""
        return self._ports.offered

    def set_impulses(self, s0: ArrayLike, s1: ArrayLike) -> None:
        """Impulses at the start and at the end of the coming steps, each (n) over the inputs of `impulse_ports` that take some.

        x0* = x + L(x) s0, the step, x1 = x1* + L(x1*) s1; [V s] at an electrical port.  Their work is in the ledger and the
        pair energies; outputs at nodes and means are without them.  They stay until set; 0 is as if they had never been.  Steps
        of no length and slivers take none.  ValueError names the ports.
        """
        require_no_events(self.model)
        self._s.impulses = self._ports.checked(s0, s1)

    def add_impulse(self, s: ArrayLike) -> None:
        """One more impulse (n) at the end of the last step, which counts as part of it."""
        self._kicks.more(self._s, np.asarray(s, float))

    def jump(self) -> Array:
        """S = L^T H'' L at the present time (n x n): by how much impulses change the outputs, y* = y + S s (A/(V s))."""
        return np.array(self._ports.kernels.jump(self._s.x[:-1], self._s.p))

    # -- stepping ---------------------------------------------------------------------------------------------------

    def do_step(self, t: float, h: float, parts: int = 1) -> None:
        """One communication step over [t, t + h] in `parts` equal internal steps.

        h < 0 goes back in time: the schemes are symmetric, so a step and the same step back give the old state
        to rounding.  h = 0 leaves the state as it is, books nothing, and gives the means their values at t.
        A sliver, what rounding leaves of a master's clock, books nothing and keeps state and means: |h| up to two
        rounding units of t or 1e-9 of the last internal step.  State events happen where they are, see `happened`; the
        step is told as one, h < 0 and inputs that are not held are refused.
        """
        if not (np.isfinite(t + h) and parts >= 1):
            raise StepFailure(Status.ARGUMENT, self.model.name, t, h)
        if h != 0 and self._is_sliver(t, h):
            self._skip(t + h)
            return
        if self.model.events is not None and h != 0:
            self._land_step(t, h, parts)
            return
        self.step_exactly(t, h, parts)

    def _land_step(self, t: float, h: float, parts: int) -> None:
        if h < 0 or (self._s.u.reshape(self.model.step.k, -1) != self.held_input).any():
            raise StepFailure(Status.ARGUMENT, self.model.name, t, h)
        before = self.get_state()
        try:
            found = told(self, t, h, parts)
        except StepFailure:
            self.restore(before)
            raise
        found.put(self._s, self.model.step, t + h)
        self.happened = found.happened

    def step_exactly(self, t: float, h: float, parts: int = 1) -> None:
        """`do_step`, however short the step is."""
        self._present.choose_rests(self._s)
        before = self.get_state()
        if h == 0:
            self._stay(t, before)
            return
        s, plan = self._s, self.model.step
        s.x[-1] = t
        s.last, s.impulses_old = self._nothing(), s.impulses.copy()
        try:
            if s.impulses.any():
                self._kicks.kick(s, s.impulses[0])
            s.x_old, s.u_old, s.path, s.halved = carried(self.model, s).copy(), s.u.copy(), [], 0
            s.w_old, s.h_old = s.w, s.h_last
            y, a, nodes_y = self._solves.take(s, t, h, parts)
            if s.impulses.any():
                self._kicks.kick(s, s.impulses[1])
        except StepFailure:
            counts = self._s.counts
            self._s = before
            self._s.counts = counts
            raise
        s.y_step, s.y_node, s.t, s.theta = y, nodes_y, t + h, 1.0
        if not plan.carries:
            s.a = a
        s.x[-1] = t + h
        last = s.last
        s.energy += last["pairs"]
        s.dissipated += last["dissipated"]
        s.supplied += last["supplied"]
        s.residual += balance(last["stored"], last["dissipated"], last["supplied"], last["numerical"])
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
            end = self._present.values(self._s)
        except StepFailure:
            self._s = before
            raise
        if not self.model.step.carries:
            s.a = end["a"].copy()
        s.x_old, s.u_old, s.path, s.last = carried(self.model, s).copy(), s.u.copy(), [], self._nothing()
        s.y_step, s.y_node = end["y"].copy(), np.tile(end["y"], (self.model.step.k, 1))
        s.counts["steps"] += 1

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
        self._ports.require_none(self._s.impulses)
        rows: dict[str, list[Array]] = {name: [] for name in record}
        held = None if inputs is None else np.asarray(inputs, float)
        if held is not None and held.shape != (n, self.model.step.nu):
            raise ValueError(f"{self.model.name}: expected values of shape {(n, self.model.step.nu)}, got {held.shape}")
        found: list[Happened] = []
        for k in range(n):
            if held is not None:
                self.set_input(held[k])
            try:
                now = self._stepped(t0 + (first + k) * h, h, parts, reads=bool({"signals", "energy"} & rows.keys()))
            except StepFailure as failure:
                failure.recorded = {name: np.array(kept) for name, kept in rows.items()}
                raise
            now |= {"unknowns": self._s.w, "x": self.x, "a": self._s.a, "y_step": self._s.y_step}
            found += self.happened
            for name, kept in rows.items():
                kept.append(now[name].copy())
        self.happened = tuple(found)
        return {name: np.array(kept) for name, kept in rows.items()}

    def land(
        self, t0: float, h: float, n: int, record: Iterable[str] = (), first: int = 0, changed: bool = True
    ) -> Iterator[Landed]:
        """Grid steps k = first..first+n-1 from t0 + k h, which end on the zeros of guards too, where state events happen.

        `record` as for `run`, a row for each step taken;  `changed`: parameters or states were set since the last step.
        StepFailure after what was accepted before: EventRefused for an event that cannot happen.
        """
        return landed(self, t0, h, n, record, first, changed)

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

    def _array(self, values: ArrayLike, *shape: int) -> Array:
        array = np.asarray(values, float)
        if array.shape != shape:
            raise ValueError(f"{self.model.name}: expected values of shape {shape}, got {array.shape}")
        if not np.isfinite(array).all():
            raise StepFailure(Status.VALUE, self.model.name, self._s.t, 0.0)
        return array
