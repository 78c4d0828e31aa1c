"""A run as a function of parameters, start values and held inputs, with the derivatives of its measures.

    y = m(run(theta)),   J = dm/dtheta,

the derivative of the steps (`docs/understand/derivatives.md`); in NumPy, as SciPy's optimisers take it.
"""

from __future__ import annotations

from collections.abc import Sequence
from threading import RLock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.derivatives.gradient import Backwards, MeasuredRun, Mode, chosen_mode, measured, stepper_of, told_by
from phfmu.derivatives.measured import RunMeasure, run_measures
from phfmu.derivatives.taped import MEMORY
from phfmu.discretise.model import Model
from phfmu.doors.function import ArgumentBlock
from phfmu.network.network import Network
from phfmu.runs.options import Options

Array = NDArray[np.float64]


class RunFunction:
    """Measures `of` a run (m) as a function of the values theta (n) of the names `by`: `f(theta)`, `f.jacobian(theta)`.

    The last run is kept, so that values and derivatives at one theta cost one run.
    instance:  of the model, or a `Coupled` of the network for members stepped apart
    options:  of the run, with its events, of which none may set what it is derived by;  inputs: data over time, as of `run`
    mode, memory: as of `gradient`
    Errors: those of `gradient`, at once; ValueError for an event that sets one of the names; of calls: StepFailure, NoDerivative.
    """

    def __init__(
        self,
        model: Model | Network,
        instance: Any,
        options: Options,
        of: Sequence[str | RunMeasure],
        by: Sequence[str],
        inputs: Any = None,
        *,
        mode: Mode = "auto",
        memory: int = MEMORY,
    ):
        self.name = model.name
        self._of = run_measures(of, told_by(model, instance))
        # one measure for each row: backwards in code, or forward
        chosen = chosen_mode(mode, instance, len(self._of), len(by))
        self._stepper = stepper_of(chosen, model, instance, by, self._of, memory)
        self._options, self._data, self._lock = options, inputs, RLock()
        own = self._stepper.by
        for e in options.events:
            if clash := own.among(e.name):
                raise ValueError(
                    f"{model.name}: the event {e.name} = {e.value:g} at t = {e.t:g} s sets {clash[0]}, which is an argument; "
                    "leave the event out, or the name"
                )
        self.inputs = (ArgumentBlock("theta", own.names),)
        self.outputs = (ArgumentBlock("y", tuple(map(str, self._of))),)
        known = self._stepper.known.start | self._stepper.inputs()
        self.start = (np.array([known[n] for n in own.names], float),)
        self._at: tuple[bytes, MeasuredRun] | None = None
        self._slopes: tuple[bytes, Array] | None = None

    def __call__(self, theta: ArrayLike) -> Array:
        """Values of the measures (m)."""
        return self.values(theta)[0]

    def values(self, *arguments: ArrayLike) -> tuple[Array, ...]:
        """(m,)"""
        with self._lock:
            return (self._run(arguments[0]).values(self._of),)

    def jacobian(self, theta: ArrayLike) -> Array:
        """Derivatives of the measures (m x n)."""
        with self._lock:
            found, key = self._run(theta), self._key(theta)
            if self._slopes is None or self._slopes[0] != key:
                self._slopes = key, found.slopes([m.weights(found.time, found.columns) for m in self._of])
            return self._slopes[1].copy()

    def forward(self, arguments: Sequence[ArrayLike], along: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """J along (m, or m x d of n x d)."""
        return (self.jacobian(arguments[0]) @ np.asarray(along[0], float),)

    def reverse(self, arguments: Sequence[ArrayLike], bars: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """J^T bars (n, or n x d of m x d); backwards in compiled code at the price of d measures."""
        bar = np.asarray(bars[0], float)
        with self._lock:
            found, key = self._run(arguments[0]), self._key(arguments[0])
            if not isinstance(self._stepper, Backwards) or (self._slopes is not None and self._slopes[0] == key):
                return (self.jacobian(arguments[0]).T @ bar,)
            own = [m.weights(found.time, found.columns) for m in self._of]
            weights = [_joined(own, column) for column in bar.reshape(len(bar), -1).T]
            return (found.slopes(weights).T.reshape(-1, *bar.shape[1:]),)

    def _key(self, theta: ArrayLike) -> bytes:
        return self.inputs[0].of(theta).tobytes()

    def _run(self, theta: ArrayLike) -> MeasuredRun:
        values = self.inputs[0].of(theta)
        key = values.tobytes()
        if self._at is None or self._at[0] != key:
            self._at = self._slopes = None
            self._stepper.begin(dict(zip(self.inputs[0].names, values.tolist(), strict=True)))
            self._at = key, measured(self._stepper, self._options, self._of, self._data)
        return self._at[1]


def _joined(weights: Sequence[dict[str, Array]], bars: Array) -> dict[str, Array]:
    """Weights of the sum of measures, each times its bar."""
    found: dict[str, Array] = {}
    for own, bar in zip(weights, bars.tolist(), strict=True):
        for signal, c in own.items():
            found[signal] = found.get(signal, 0.0) + bar * c
    return found
