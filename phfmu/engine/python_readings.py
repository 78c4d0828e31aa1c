"""What an instance in Python tells: its state, its last step and how that follows its inputs, and the present."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.engine.impulses import Kicks, Ports
from phfmu.engine.node_sensitivity import NodeSensitivity, chosen, columns, directions
from phfmu.engine.present import Present
from phfmu.engine.rest_changes import RestChange, named
from phfmu.engine.solves import Solves
from phfmu.engine.state import State
from phfmu.engine.status import Status, StepFailure

Array = NDArray[Any]


class PythonReadings:
    """The state of an instance of `model`, and how it is read."""

    def __init__(self, model: Model):
        self.model = model
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
        s, end = self._s, self._present.values(self._s)
        return {
            "x": s.x[:-1].copy(), "time": s.x[-1:].copy(), "a": s.a.copy(), "y_step": s.y_step.copy(), "energy": s.energy.copy(),
            "supplied": s.supplied.copy(), "dissipated": s.dissipated.copy(),
            "residual": s.residual.copy(), "a_end": end["a"].copy(), "y_end": end["y"].copy(),
            "observables": end["o"].copy(), "H": end["H"].copy(),
        }  # fmt: skip

    def signal(self, block: str) -> Array:
        """One block of `signals`."""
        return self.signals()[block]

    def sensitivity(self, end: bool = False) -> Array:
        """S = d(mean external outputs)/d(held inputs) of the last step (nu x nu): implicit function theorem.

        Internal steps are chained.  `end`: of the outputs at the present time instead.  StepFailure NO_SENSITIVITY before the
        first step, or where more than 16 internal steps of the last one were halved.
        """
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
        """Derivatives of the last step with respect to the chosen inputs (default: all) at each of its nodes.

        `impulses`: then with respect to those at its start and at its end too, in the order of `set_impulses`;  `end`: of the
        outputs at its end too.  StepFailure NO_SENSITIVITY as in `sensitivity`.
        """
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
