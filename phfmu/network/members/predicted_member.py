"""A unit that cannot take a step back: others step against what it is expected to do, then it steps once.

Its mean outputs are predicted from the outputs y(t) where it is,

    Y = y(t) + b + G (U - U_last),      G = dY/dU of the first step,

with b = Y_last - y(t_last) of the last step; should its length change, b and G are in proportion to it.  What the prediction
misses is left in the rows of its junctions, which book it: sum h U^T Y.  Exact for linear members without feedthrough whose
free motion is uniform.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.rest_changes import RestChange
from phfmu.outcome.steps import StepEvent
from phfmu.signals import SignalKind

if TYPE_CHECKING:
    from phfmu.network.members.fmu_member import FMUMember

Array = NDArray[np.float64]

WINDOW = 20  # steps over which misses are averaged
POOR = 0.5  # an average of misses, relative to the outputs, from which on they say nothing
FLOOR = 1e-6  # of the largest output: what is below it counts as rest


class PredictedMember:
    """The member `inner`, whose steps are put off until `finish`; response: `rollback.response` to a step of length h."""

    finishes, repeated = True, 0.0

    def __init__(self, inner: FMUMember, h: float, response: tuple[Array, Array]):
        self.inner, self._h, (first, self._G) = inner, h, response
        self.name, self.nu, self.names = inner.name, inner.nu, inner.names
        self.places, self.nominal, self.booking = inner.places, inner.nominal, inner.booking
        self.input_sign, self.saves, self.taken, self.sent = inner.input_sign, False, inner.taken, inner.sent
        self._u = inner.start_inputs()
        self._end = inner.end_output().copy()
        self._last, self._b = self._u, first - self._end
        self._put_off: tuple[float, float] | None = None
        #: how much predictions miss of the outputs, on average over the last steps, at most 1
        self.missed = 0.0
        self._largest = float(np.abs(first).max(initial=0.0))

    @property
    def ended(self) -> bool:
        """Whether it has asked to end the simulation in the last step."""
        return self.inner.ended

    # -- of a step ----------------------------------------------------------------------------------------------------

    def set_input(self, u: Array) -> None:
        self._u = np.array(u)
        self.inner.set_input(u)

    def begin(self, u: Array) -> None:
        self.set_input(u)

    def do_step(self, t: float, h: float) -> None:
        if h != self._h:
            self._b, self._G, self._h = self._b * (h / self._h), self._G * (h / self._h), h
        self._put_off = t, h

    def finish(self) -> None:
        """The step that was put off, under the inputs that were found for it."""
        if self._put_off is None:
            return
        (t, h), predicted = self._put_off, self.output()
        self.inner.do_step(t, h)
        self._put_off, Y = None, self.inner.output()
        self._watch(predicted, Y)
        self._b, self._last = Y - self._end, self._u
        self._end = self.inner.end_output().copy()

    def _watch(self, predicted: Array, Y: Array) -> None:
        size = max(float(np.abs(Y).max(initial=0.0)), float(np.abs(self._end).max(initial=0.0)))
        self._largest = max(self._largest, size)
        scale = max(size, FLOOR * self._largest)
        miss = min(float(np.abs(Y - predicted).max(initial=0.0)) / scale, 1.0) if scale else 0.0
        self.missed += (miss - self.missed) / WINDOW

    def output(self) -> Array:
        if self._put_off is None:
            return self.inner.output()
        return self._end + self._b + self._G @ (self._u - self._last)

    def end_output(self) -> Array:
        return self.inner.end_output()

    def sensitivity(self) -> Array:
        return self._G

    @property
    def unwritten(self) -> str:
        """It is stepped last since it cannot take steps back."""
        return f"{self.name} cannot take its state back"

    def get_state(self) -> None:
        """The unit is where it is; nothing is kept."""

    def set_state(self, state: None) -> None:
        """A step that was put off is forgotten; one that was taken stays."""
        self._put_off = None

    def unsteady(self, _: float) -> str:
        """It repeats no step."""
        return ""

    # -- as of any other member ---------------------------------------------------------------------------------------

    @property
    def units(self) -> dict[str, str]:
        return self.inner.units

    @property
    def kinds(self) -> Mapping[str, SignalKind]:
        return self.inner.kinds

    @property
    def labels(self) -> Mapping[str, str]:
        return self.inner.labels

    @property
    def input_names(self) -> list[str]:
        return self.inner.input_names

    def signals(self) -> dict[str, float]:
        return self.inner.signals()

    def settable(self) -> list[str]:
        return self.inner.settable()

    def input_places(self, name: str) -> list[int]:
        return self.inner.input_places(name)

    def set_parameter(self, name: str, value: float) -> str:
        return self.inner.set_parameter(name, value)

    def read_signals(self, names: Sequence[str]) -> Array:
        return self.inner.read_signals(names)

    def write_signals(self, names: Sequence[str], values: Array) -> None:
        self.inner.write_signals(names, values)

    def start_inputs(self) -> Array:
        return self.inner.start_inputs()

    def hashed(self) -> dict[str, float]:
        return self.inner.hashed()

    def ledger(self) -> dict[str, Array]:
        return self.inner.ledger()

    def happened(self) -> list[StepEvent]:
        return self.inner.happened()

    def energies(self) -> Array:
        return self.inner.energies()

    def read(self) -> Array:
        return self.inner.read()

    def rest_changes(self) -> list[RestChange]:
        return self.inner.rest_changes()

    def check_start(self) -> None:
        self.inner.check_start()
