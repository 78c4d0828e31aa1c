"""The derivative of measures of a run by parameters, start values and held inputs.

    max(gen.w) by gen.J:   d(gen.w)/d(gen.J) at the row of the largest value

Forward, the tangents of all columns go along with the steps (`sensitive.py`), at a cost for each name; backwards, the bars of the
measures go back over the tape of the run (`taped.py`), at a cost for each measure, whatever the number of names.  Both are the
derivative of the same steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.apart.derived_members import by_of
from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
from phfmu.derivatives.apart.taped_members import TapedMembers
from phfmu.derivatives.by import IndependentVariables, require_known
from phfmu.derivatives.measured import TIME, RunMeasure, run_measures
from phfmu.derivatives.sensitive import SensitiveSteps
from phfmu.derivatives.tangents import require_derived
from phfmu.derivatives.taped import MEMORY, TapedSteps
from phfmu.discretise.model import Model
from phfmu.engine.native.native import NativeInstance
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.members.columns import SignalColumns
from phfmu.network.network import Network
from phfmu.runs.loop import run
from phfmu.runs.options import Options
from phfmu.signals import derivative_name

Array = NDArray[np.float64]
Mode = Literal["auto", "forward", "reverse"]

#: what goes forward costs, in measures that go backwards in compiled code (measured on smib and ladder): the linearisations of a
#: run, which NumPy solves, and each name
LINEARISED, NAMED = 50, 2

#: steps with derivatives, of one composed model or of members stepped apart
Forward = SensitiveSteps | SensitiveMembers
Backwards = TapedSteps | TapedMembers


@dataclass(frozen=True)
class Gradient:
    """Values of the measures, and their derivatives `slopes` (measures x names); `mode`: forward or reverse.

    notes: where the sequence of state events, of which these are the derivatives, is close to another one
    """

    measures: tuple[str, ...]
    names: tuple[str, ...]
    values: Array
    slopes: Array
    mode: str
    notes: tuple[str, ...] = ()

    def by(self, measure: str, name: str) -> float:
        """One derivative; ValueError for a measure or name that was not asked for."""
        return float(self.slopes[self.measures.index(measure), self.names.index(name)])


def gradient(
    model: Model | Network,
    instance: Any,
    options: Options,
    of: Sequence[str | RunMeasure],
    by: Sequence[str],
    inputs: Any = None,
    *,
    mode: Mode = "auto",
    memory: int = MEMORY,
) -> Gradient:
    """Derivatives of measures `of` a run (`max(gen.w)`, `integral(line.i^2)`, `energy.dissipated@end`) by the names `by`.

    instance:  of the model, or a `Coupled` of the network for members stepped apart
    options:  of the run, with its events;  inputs: data over time, as of `run`
    mode:  forward (tangents), reverse (adjoint, native instances), or auto, the one that costs less
    memory:  bytes that the tape may take backwards; stretches of steps beyond it are run twice
    Errors: ValueError for measures that are none, or have no derivative (the time of an extreme is that of a row); those of
    `SensitiveSteps` and `SensitiveMembers`; NoDerivative, with its time.
    """
    wanted = run_measures(of, told_by(model, instance))
    names = (
        by_of(instance.joined, by)
        if isinstance(instance, Coupled)
        else IndependentVariables.of(_model(model).declaration, by)
    ).names
    chosen = chosen_mode(mode, instance, len(wanted), len(names))
    found = measured(stepper_of(chosen, model, instance, by, wanted, memory), options, wanted, inputs)
    slopes = found.slopes([m.weights(found.time, found.columns) for m in wanted])
    notes = tuple(found.stepper.notes())
    return Gradient(tuple(map(str, wanted)), names, found.values(wanted), slopes, chosen, notes)


@dataclass(frozen=True)
class MeasuredRun:
    """A run by a stepper with derivatives: times and columns of its rows that are measured."""

    stepper: Forward | Backwards
    time: Array
    columns: dict[str, Array]
    #: by signal, of forward steps: the derivatives of its rows (rows x names)
    along: dict[str, Array]

    def values(self, of: Sequence[RunMeasure]) -> Array:
        """Values of measures (n)."""
        return np.array([m.value(self.time, self.columns) for m in of])

    def slopes(self, weights: Sequence[dict[str, Array]]) -> Array:
        """Derivatives (n x names) of n numbers of the run with weights by signal and row."""
        if isinstance(self.stepper, Backwards):
            return self.stepper.slopes(weights)
        n = len(self.stepper.by.names)
        own = [{s: c for s, c in w.items() if s in self.along} for w in weights]
        found = [sum((_weighted(c, self.along[s], s) for s, c in w.items()), np.zeros(n)) for w in own]
        return np.array(found).reshape(len(weights), n)


def _weighted(c: Array, rows: Array, signal: str) -> Array:
    """c @ rows of those that count; ValueError for one that has no derivative."""
    counts = c != 0.0
    found = c[counts] @ rows[counts]
    require_known(found, signal)
    return found


def stepper_of(
    chosen: str,
    model: Model | Network,
    instance: Any,
    by: Sequence[str],
    of: Sequence[RunMeasure],
    memory: int = MEMORY,
) -> Forward | Backwards:
    """Steps whose runs tell measures and their derivatives, the way that was chosen."""
    signals = _signals(of)
    if chosen == "forward":
        return forward_of(model, instance, by, signals)
    if isinstance(instance, Coupled):
        return TapedMembers(instance, by, signals)
    model = _model(model)
    require_derived(model)
    taped = TapedSteps(model, instance, by, memory)
    taped.needs(signals)
    return taped


def measured(
    stepper: Forward | Backwards, options: Options, of: Sequence[RunMeasure], inputs: Any = None
) -> MeasuredRun:
    """The run of a stepper that was made for these measures."""
    signals, names = _signals(of), stepper.by.names
    wanted = signals if isinstance(stepper, Backwards) else stepper.columns
    found = run(stepper, replace(options, every=None, signals=wanted), inputs=inputs)
    along = {}
    if not isinstance(stepper, Backwards):
        moved = [TIME] if stepper.moves else []
        along = {s: np.column_stack([found.column(derivative_name(s, n)) for n in names]) for s in moved + signals}
    return MeasuredRun(stepper, found.time, {n: found.column(n) for n in signals}, along)


def told_by(model: Model | Network, instance: Any) -> list[str]:
    """The columns of a run."""
    return instance.names if isinstance(instance, Coupled) else SignalColumns(_model(model), instance.layout).names


def forward_of(model: Model | Network, instance: Any, by: Sequence[str], signals: Sequence[str]) -> Forward:
    """Steps with derivatives of these signals beside them."""
    if isinstance(instance, Coupled):
        return SensitiveMembers(instance, by, signals)
    return SensitiveSteps(_model(model), instance, by, signals)


def _model(model: Model | Network) -> Model:
    """ValueError for a network, which is stepped by no instance."""
    if isinstance(model, Network):
        raise ValueError(
            f"{model.name} is a network; give it with a Coupled of its members, or the model of its compose()"
        )
    return model


def _signals(of: Sequence[RunMeasure]) -> list[str]:
    return list(dict.fromkeys(n for m in of for n in m.signals))


def chosen_mode(mode: Mode, instance: Any, measures: int, names: int) -> str:
    """Forward or reverse, what costs less if it is open; ValueError where a mode is none, or has no code."""
    if mode not in get_args(Mode):
        raise ValueError(f"mode '{mode}': expected {', '.join(get_args(Mode))}")
    if isinstance(instance, Coupled):  # both ways in NumPy, over the same linearisations; state events forward only
        return mode if mode != "auto" else "reverse" if measures < names and not instance.lands else "forward"
    native = isinstance(getattr(instance, "present", instance), NativeInstance)
    if mode == "reverse" and not native:
        raise ValueError("derivatives go backwards in compiled code only; take a NativeInstance, or mode forward")
    if mode != "auto":
        return mode
    return "reverse" if native and measures <= LINEARISED + NAMED * names else "forward"
