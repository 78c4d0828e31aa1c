"""Runs by the run loop, for what the compiled one does not take: members stepped apart, units, the Python engine, adaptive and
damped steps, whole results.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.stepper import Stepper
from phfmu.network.members.consistent import InconsistentState
from phfmu.outcome.status import StepFailure
from phfmu.runs.loop import run
from phfmu.runs.options import Options
from phfmu.sweeps.outcome import RunOutcomes, SweepStopped
from phfmu.sweeps.places import INPUT, PARAMETER, STATE, Places
from phfmu.sweeps.task import ModelTask, Task

#: the stepper of a run that begins with these values, and the options of that run
Make = Callable[[Mapping[str, float]], tuple[Stepper, Options]]


class GeneralRuns:
    """Takes one run after the other, each by a stepper that `make` gives for its values.

    The stepper of the run before is kept until the next one stands: alike models share plans and code as long as one is in use.
    """

    def __init__(self, task: Task, make: Make, keep: Path | None = None):
        self._task, self._make, self._keep = task, make, keep
        self._before: Stepper | None = None
        self._stopped = False

    def take(self, rows: NDArray[Any], first: int = 0) -> RunOutcomes:
        """Runs with these values (n x names), of which the first has this number."""
        return RunOutcomes.joined([self._one(row, first + i) for i, row in enumerate(np.asarray(rows, float))])

    def stop(self) -> None:
        """Called from another thread: end runs under way with SweepStopped."""
        self._stopped = True

    def _goes_on(self, _: float) -> None:
        if self._stopped:
            raise SweepStopped

    def _one(self, row: NDArray[Any], number: int) -> RunOutcomes:
        task = self._task
        try:
            stepper, options = self._make(dict(zip(task.names, row.tolist(), strict=True)))
            self._before = stepper
            found = run(stepper, replace(options, progress=self._goes_on))
        except (StepFailure, InconsistentState) as error:
            return RunOutcomes(np.full((1, len(task.measures)), np.nan), np.zeros(1, int), np.zeros(1), (str(error),))
        if self._keep is not None:
            found.save(self._keep / f"{number:06d}.parquet")
        told = [m.of(found.time, found.column(m.signal)) for m in task.measures]
        missed = found.ledger.summary().most
        return RunOutcomes(np.array([told]).reshape(1, -1), np.array([found.steps]), np.array([missed]), ("",))


def of_model(task: ModelTask, engine: type) -> Make:
    """Steppers of one composed model by instances of `engine`."""
    model, options, places = task.model, task.options, Places(task.model)

    def make(given: Mapping[str, float]) -> tuple[Stepper, Options]:
        values = {PARAMETER: model.p0.copy(), STATE: model.x0.copy(), INPUT: model.u0.copy()}
        for name, value in given.items():
            for p in places.of(name):
                values[p.kind][p.index] = value
        starts = {"p0": values[PARAMETER], "x0": values[STATE], "u0": values[INPUT]}
        own = replace(model, first=model.first or model, **starts)
        instance = engine(own)
        if options.t0 != model.t0:
            instance.set_x(options.t0, own.x0)
            instance.initialise()
        return Monolithic(own, instance), options

    return make
