"""The reference engine: an instance stepped in Python, one statement of the method after the other.

Its base class reads the state, the last step with its sensitivities, and values at the present time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.discretise.model import Model
from phfmu.engine.impulses import Ports, PythonImpulses
from phfmu.engine.instance import Instance
from phfmu.engine.model import require_no_landing
from phfmu.engine.node_sensitivity import NodeSensitivity, chosen, columns, directions
from phfmu.engine.record import Grid, step_by_step
from phfmu.engine.reference.evaluate import carried
from phfmu.engine.reference.present import PresentValues
from phfmu.engine.reference.solves import Solves
from phfmu.engine.reference.state import State
from phfmu.engine.rest_changes import RestChange, named
from phfmu.outcome.limits import is_sliver
from phfmu.outcome.status import Status, StepFailure
from phfmu.outcome.steps import Landed, balance

Array = NDArray[Any]


class PythonReadings(Instance):
    """The state of an instance of `model`, and how it is read."""

    model: Model

    def __init__(self, model: Model):
        super().__init__(model)
        self._solves, self._present, self._ports = Solves(model), PresentValues(model), Ports(model.declaration)
        self._kicks = PythonImpulses(self._ports)
        self._s = State.at_start(model)

    @property
    def time(self) -> float:
        return self._s.t

    @property
    def x(self) -> Array:
        return self._s.x[:-1].copy()

    @property
    def counts(self) -> dict[str, int]:
        return dict(self._s.counts)

    @property
    def rest_changes(self) -> list[RestChange]:
        return named(self._s.changes, self.model.hold_names)

    def output(self) -> Array:
        return self._s.y_step[: self.model.step.nu].copy()

    def node_output(self) -> Array:
        return self._s.y_node[:, : self.model.step.nu].copy()

    def ledger(self) -> dict[str, Array]:
        return {k: v.copy() for k, v in self._s.last.items()}

    @property
    def solves(self) -> int:
        return len(self._s.path)

    @property
    def unknowns(self) -> Array:
        return self._s.w.copy()

    def signals(self) -> dict[str, Array]:
        end = self._present.values(self._s)
        now = {"a_end": end["a"], "y_end": end["y"], "observables": end["o"], "H": end["H"]}
        return {name: values.copy() for name, values in (self._past() | now).items()}

    def signal(self, block: str) -> Array:
        past = self._past()
        return past[block].copy() if block in past else self.signals()[block]

    def _past(self) -> dict[str, Array]:
        """Blocks that are known without solving for the present."""
        s = self._s
        return {
            "x": s.x[:-1], "time": s.x[-1:], "a": s.a, "y_step": s.y_step, "energy": s.energy,
            "supplied": s.supplied, "dissipated": s.dissipated, "residual": s.residual,
        }  # fmt: skip

    def sensitivity(self, end: bool = False) -> Array:
        s = self._s
        if end:
            return self._present.sensitivity(s)
        found = self._solves.sensitivity(s)
        if found is None:
            raise StepFailure(Status.NO_SENSITIVITY, self.model.name, s.t, s.h_last)
        return found

    def node_sensitivity(
        self, inputs: Sequence[int] | None = None, impulses: bool = False, end: bool = False
    ) -> NodeSensitivity:
        s, plan = self._s, self.model.step
        du, ds = directions(plan, chosen(plan, inputs), self._ports.kernels.n if impulses else 0)
        dx = np.zeros((len(du), len(s.x_old)))
        found = self._solves.along(s, du, self._kicks.start_along(s, dx, ds[:, 0]) if impulses else dx)
        if found is None:
            raise StepFailure(Status.NO_SENSITIVITY, self.model.name, s.t, s.h_last)
        dy, dx = found
        if impulses or s.impulses_old.any():
            dx = self._kicks.end_along(s, dx, ds[:, 1])
        return columns(plan, dy, dx, self._present.along(s, du, dx) if end else None)


class PythonInstance(PythonReadings):
    """An instance stepped in Python, to be read; `NativeInstance` gives the same numbers, `Instance` describes both.

    A model with state events has values and single exact steps here; Refusal where guards would have to be looked at.
    """

    def __init__(self, model: Model):
        super().__init__(model)
        self.initialise()

    # -- state ------------------------------------------------------------------------------------------------------

    def reset(self) -> None:
        self._s = State.at_start(self.model)
        self.initialise()

    def initialise(self) -> None:
        s, plan = self._s, self.model.step
        s.end = None
        end = self._present.values(self._s)
        s.a = end["a"].copy()
        s.y_step, s.y_node = end["y"].copy(), np.tile(end["y"], (plan.k, 1))
        s.w = np.zeros(plan.nw)
        level = plan.seeds
        s.w[plan.mean_w[level]] = s.a[plan.mean_a[level]]
        s.h_last = 0.0
        s.last = self._nothing()

    def _nothing(self) -> dict[str, Array]:
        """The ledger of a step in which nothing moved."""
        plan = self.model.step
        sums = {n: np.zeros(plan.ncomp) for n in ("stored", "dissipated", "supplied", "numerical", "moved")}
        return sums | {"pairs": np.zeros(plan.nq)}

    def get_state(self) -> State:
        return self._s.copy()

    def set_state(self, state: State) -> None:
        self._s = state.copy()

    def restore(self, state: Any) -> None:
        counts = self._s.counts
        self.set_state(state)
        self._s.counts = counts | {"steps": state.counts["steps"]}

    def set_input(self, u: ArrayLike) -> None:
        self._s.u = np.tile(self._finite(u, self.model.step.nu), self.model.step.k)
        self._s.theta, self._s.end = 0.0, None

    def set_node_inputs(self, u: ArrayLike) -> None:
        self._s.u = self._finite(u, self.model.step.k, self.model.step.nu).ravel().copy()
        self._s.theta, self._s.end = 0.0, None

    def set_parameters(self, p: ArrayLike) -> None:
        self._s.p = self._finite(p, self.model.step.np).copy()
        self._s.placed, self._s.end = True, None

    @property
    def parameters(self) -> Array:
        return self._s.p.copy()

    @property
    def held_input(self) -> Array:
        return self._s.u[: self.model.step.nu].copy()

    def set_x(self, t: float, x: ArrayLike) -> None:
        self._finite([t], 1)
        self._s.x[:-1], self._s.x[-1], self._s.t = self._finite(x, self.model.step.nx), t, t
        self._s.carry[:] = 0.0
        self._s.placed, self._s.end = True, None

    def continue_from(self, other: PythonInstance) -> None:
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
            level = mine.seeds
            s.w[mine.mean_w[level]], s.h_last = s.a[mine.mean_a[level]], 0.0
        if len(s.rests) != len(old.rests):
            s.rests, s.placed = old.rests, True
        self._s = s

    def _take_impulses(self, s: Array) -> None:
        self._s.impulses = s

    def add_impulse(self, s: ArrayLike) -> None:
        self._kicks.more(self._s, np.asarray(s, float))

    def jump(self) -> Array:
        return np.array(self._ports.kernels.jump(self._s.x[:-1], self._s.p))

    # -- stepping ---------------------------------------------------------------------------------------------------

    def do_step(self, t: float, h: float, parts: int = 1) -> None:
        if not (np.isfinite(t + h) and parts >= 1):
            raise StepFailure(Status.ARGUMENT, self.model.name, t, h)
        if h != 0 and is_sliver(t, h, self._s.h_last):
            self.skip(t + h)
            return
        if h != 0:
            require_no_landing(self.model)
        self.step_exactly(t, h, parts)

    def step_exactly(self, t: float, h: float, parts: int = 1) -> None:
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

    def skip(self, t: float) -> None:
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

    def _run(self, grid: Grid, names: tuple[str, ...], inputs: Array | None) -> dict[str, Array]:
        self._ports.require_none(self._s.impulses)
        require_no_landing(self.model)
        return step_by_step(self, grid, names, inputs)[0]

    def _land(self, grid: Grid, names: tuple[str, ...], changed: bool) -> Iterator[Landed]:
        require_no_landing(self.model)
        raise ValueError(f"{self.model.name} has no state events: use run")

    def _finite(self, values: ArrayLike, *shape: int) -> Array:
        array = self._array(values, *shape)
        if not np.isfinite(array).all():
            raise StepFailure(Status.VALUE, self.model.name, self._s.t, 0.0)
        return array
