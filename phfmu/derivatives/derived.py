"""Steps of a composed model that derivatives go along with, forward or backwards: what both need, and refuse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import By
from phfmu.discretise.model import Model
from phfmu.discretise.start import Projection
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.members.inputs import Inputs
from phfmu.network.scene import Event
from phfmu.outcome.steps import Steps
from phfmu.schemes.scheme import Scheme

Array = NDArray[np.float64]


class DerivedSteps(Monolithic):
    """Steps of one composed model whose rows are derived by parameters, held inputs or start values `by`.

    Errors: KeyError for names that are none; ValueError for models and steps without derivatives, with the remedy.
    """

    def __init__(self, model: Model, instance: Any, by: Sequence[str]):
        super().__init__(model, instance)
        self.by = By.of(model.declaration, by)
        #: states after the last step, None before the first one
        self._last: Array | None = None
        #: states that the start was given, before a projection
        self._given = instance.x[: model.step.nx].copy()

    @property
    def begun(self) -> bool:
        """Steps were taken: a value that is set now belongs to no start."""
        return self._last is not None

    def begin(self, values: Mapping[str, float]) -> None:
        """Back to the start, with other parameters, start values or held inputs, by scalar name."""
        i, d = self.instance, self.model.declaration
        i.reset()
        self._inputs = Inputs(i, self.model)
        p, x = self.model.p0.copy(), self.model.x0.copy()
        states = {n: j for j, n in enumerate(n for v in d.states for n in v.names())}
        for name, value in values.items():
            if name in states:
                x[states[name]] = value
            elif name in self._inputs.parameters:
                p[self._inputs.parameters[name]] = value
            else:
                self._inputs.u[self._inputs.inputs[name]] = value
        i.set_parameters(p)
        i.set_input(self._inputs.u)
        i.set_x(self.model.t0, x)
        i.initialise()
        self._rebook()
        self._given, self._last = x, None
        self.forget()

    def forget(self) -> None:
        """What was kept of the steps so far belongs to another run."""

    def cut(self, name: str) -> None:
        """A value of a parameter or input is set that does not follow that of the start."""

    def set_value(self, name: str, value: float) -> str:
        kind = super().set_value(name, value)
        if self.begun:
            self.cut(name)
        return kind

    def project_start(self, t0: float, kept: Sequence[str] = ()) -> Projection | None:
        """As of `Monolithic`; ValueError with states that are kept, which the tangents of a start do not know."""
        if kept and not self.begun:
            raise ValueError(f"{self.model.name}: derivatives and --keep {kept[0]} do not go together")
        return super().project_start(t0, kept)

    def companion(self, scheme: Scheme) -> Any:
        """ValueError: damping steps and steps of several sizes have no derivatives."""
        raise ValueError(f"{self.model.name}: derivatives are told of equal steps; leave out --restart and --rtol")

    def advance_with(self, inputs: Sequence[tuple[int, Event]], t0: float, h: float, n: int, first: int = 0) -> Steps:
        """As of `Monolithic`; ValueError where an input changes that is derived by."""
        followed = () if self.followed is None else self.followed.names
        for name in dict.fromkeys([*(e.name for _, e in inputs), *followed]):
            if clash := self.by.among(name):
                raise ValueError(
                    f"{self.model.name}: {clash[0]} is set within the run, by an event or by data, so that there is no one "
                    "value of it to be derived by"
                )
        return super().advance_with(inputs, t0, h, n, first)

    def require_continued(self, t: float) -> None:
        """ValueError where states were moved between two steps."""
        x = self.instance.x[: self.model.step.nx]
        if self._last is not None and not np.array_equal(x, self._last):
            raise ValueError(
                f"{self.model.name}: states were moved at t = {t:.9g} s (a projection after an event), which derivatives do "
                "not follow; let the event keep the constraints"
            )
        self._last = x.copy()
