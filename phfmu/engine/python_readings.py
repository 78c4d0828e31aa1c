"""What an instance in Python tells: its state, its last step and how that follows its inputs, and the present."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.engine.impulses import Kicks, Ports
from phfmu.engine.instance import Instance
from phfmu.engine.node_sensitivity import NodeSensitivity, chosen, columns, directions
from phfmu.engine.present import Present
from phfmu.engine.rest_changes import RestChange, named
from phfmu.engine.solves import Solves
from phfmu.engine.state import State
from phfmu.engine.status import Status, StepFailure

Array = NDArray[Any]


class PythonReadings(Instance):
    """The state of an instance of `model`, and how it is read."""

    model: Model

    def __init__(self, model: Model):
        super().__init__(model)
        self._solves, self._present, self._ports = Solves(model), Present(model), Ports(model.declaration)
        self._kicks = Kicks(self._ports)
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
