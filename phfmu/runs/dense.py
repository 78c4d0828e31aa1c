"""Values between step ends, for plots: the collocation polynomial of the states.

    x(t + tau h) = x + s0 + sum_j (int_0^tau l_j) D_j,     s0: impulses at bare nodes at the start of the step,

of degree k, exact at the step ends, with an error of order k + 1 between them.  What follows from the states (algebraic
values, outputs, observables, energy) is solved at x(t + tau h); step means are those of the step, and cumulative
energies a straight line.  Between the ends nothing is conserved: balance and constraints hold at the step ends.

Steps that end at state events have their own polynomial each, in the modes that they were taken in: no row is interpolated
over an event.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.discretise.within import polynomial_of

Array = NDArray[np.float64]

#: blocks that belong to an instant; the others to a step or to all steps before
INSTANT = ("x", "time", "a_end", "y_end", "observables", "H")
SUMS = ("energy", "supplied", "dissipated", "residual")
#: what the end of a step may differ from that of its polynomial: of the states, and of what they changed by
ROUNDING, DIVIDED = 1e-12, 1e-3


class DenseOutput:
    """Rows of the signal table at `rows` equal distances within each step."""

    def __init__(self, instance: Any, rows: int):
        self.tau = np.arange(1, rows + 1) / (rows + 1)
        self._viewers: dict[int, _Viewer] = {}

    def between(self, instance: Any, before: Array, r: dict[str, Array], t: Array, h: Array) -> Array:
        """Table rows (n x rows x width) within the n recorded steps from t (n) of sizes h (n); nan in those that were divided.

        `before`: the table row at their start;  r: signals, unknowns, counts of the steps.  Modes are those of the rows.
        """
        ends, layout = np.vstack([before[None], r["signals"]]), instance.layout
        out = np.full((len(ends) - 1, len(self.tau), ends.shape[1]), np.nan)
        for k in range(len(out)):
            viewer, x = self._viewer(instance, ends[k + 1]), ends[k, layout["x"]]
            if r["counts"][k, 1] != 1 and not viewer.whole(x, r["unknowns"][k], ends[k + 1, layout["x"]]):
                continue
            for j, tau in enumerate(self.tau):
                row = out[k, j]
                row[:] = ends[k + 1]
                for name in SUMS:
                    row[layout[name]] = (1 - tau) * ends[k, layout[name]] + tau * ends[k + 1, layout[name]]
                now = viewer.at(t[k] + tau * h[k], x, r["unknowns"][k], float(tau))
                for name in INSTANT:
                    row[layout[name]] = now[name][: layout[name].stop - layout[name].start]
        return out

    def _viewer(self, instance: Any, row: Array) -> _Viewer:
        """With the inputs and parameters of the instance, in the modes that are in a row of the table."""
        model, present, p = instance.model, instance, instance.parameters
        if modes := model.declaration.modes:
            names = [n for v in model.declaration.parameters for n in v.names()]
            first = instance.layout["observables"].start
            for name in modes:
                if name in model.observable_names:
                    p[names.index(name)] = row[first + model.observable_names.index(name)]
        if model.modes is not None:
            present = instance.present
            model = model.modes[tuple(int(p[i]) for i in model.modes.modes.system.places)]
        if id(model) not in self._viewers:
            self._viewers[id(model)] = _Viewer(model, type(present))
        viewer = self._viewers[id(model)]
        viewer.instance.continue_from(present)
        viewer.instance.set_parameters(p)
        return viewer


class _Viewer:
    """The polynomial of a model's scheme, and a second instance that shows what follows from its states."""

    def __init__(self, model: Model, kind: Callable[[Model], Any]):
        self.polynomial, self.instance, self._plan = polynomial_of(model), kind(model), model.step
        self._nominal = np.array([n for v in model.declaration.states for n in v.nominal])

    def whole(self, x: Array, unknowns: Array, end: Array) -> bool:
        """Whether a step from x to `end` with these unknowns was taken in one part: those of a part do not lead there."""
        plan = self._plan
        reached = x + np.bincount(plan.update_x, plan.update_c * unknowns[plan.update_w], len(x))
        small = ROUNDING * (np.abs(x) + self._nominal) + DIVIDED * np.abs(end - x)
        return bool((np.abs(reached - end) <= small).all())

    def at(self, t: float, x: Array, unknowns: Array, tau: float) -> dict[str, Array]:
        """Signals at the fraction tau of the step from x, at time t."""
        self.instance.set_x(t, self.polynomial(x, unknowns, tau))
        self.instance.initialise()
        return self.instance.signals()
