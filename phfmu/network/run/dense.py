"""Values between step ends, for plots: the collocation polynomial of the states.

    x(t + tau h) = x + s0 + sum_j (int_0^tau l_j) D_j,     s0: impulses at bare nodes at the start of the step,

of degree k, exact at the step ends, with an error of order k + 1 between them.  What follows from the states (algebraic
values, outputs, observables, energy) is solved at x(t + tau h); step means are those of the step, and cumulative
energies a straight line.  Between the ends nothing is conserved: balance and constraints hold at the step ends.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.discretise.onestep import step_layout
from phfmu.events.polynomial import Polynomial
from phfmu.terms.extract import extract

Array = NDArray[np.float64]

#: blocks that belong to an instant; the others to a step or to all steps before
INSTANT = ("x", "time", "a_end", "y_end", "observables", "H")
SUMS = ("energy", "supplied", "dissipated", "residual")


def polynomial_of(model: Model) -> Polynomial:
    """The states within a step of a model."""
    scheme = model.scheme
    layout = step_layout(extract(model.declaration, joint=scheme.joint), scheme)
    return Polynomial(layout, scheme.nodes, scheme.maps(layout))


class Dense:
    """Rows of the signal table at `rows` equal distances within each step."""

    def __init__(self, instance: Any, rows: int):
        self.tau = np.arange(1, rows + 1) / (rows + 1)
        self._kind = type(instance)
        self._viewers: dict[int, tuple[Polynomial, Any]] = {}

    def between(self, instance: Any, before: Array, r: dict[str, Array], t0: float, h: float, first: int) -> Array:
        """Table rows (n x rows x width) within the n recorded steps from t0 + first h of size h; nan in steps that were divided.

        `before`: the table row at their start;  r: signals, unknowns, counts of the steps.
        """
        ends, layout = np.vstack([before[None], r["signals"]]), instance.layout
        out = np.full((len(ends) - 1, len(self.tau), ends.shape[1]), np.nan)
        polynomial, viewer = self._viewer(instance)
        for k in np.flatnonzero(r["counts"][:, 1] == 1):
            for j, tau in enumerate(self.tau):
                row = out[k, j]
                row[:] = ends[k + 1]
                for name in SUMS:
                    row[layout[name]] = (1 - tau) * ends[k, layout[name]] + tau * ends[k + 1, layout[name]]
                x = polynomial(ends[k, layout["x"]], r["unknowns"][k], float(tau))
                viewer.set_x(t0 + (first + k + tau) * h, x)
                viewer.initialise()
                now = viewer.signals()
                for name in INSTANT:
                    row[layout[name]] = now[name]
        return out

    def _viewer(self, instance: Any) -> tuple[Polynomial, Any]:
        """The polynomial of the instance's scheme and a second instance with its inputs and parameters."""
        key = id(instance)
        if key not in self._viewers:
            self._viewers[key] = polynomial_of(instance.model), self._kind(instance.model)
        polynomial, viewer = self._viewers[key]
        viewer.continue_from(instance)
        return polynomial, viewer
