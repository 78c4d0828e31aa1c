"""Runs by the run loop, for what the compiled one does not take: the Python engine, adaptive and damped steps, whole results."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.members.consistent import InconsistentState
from phfmu.outcome.status import StepFailure
from phfmu.runs.loop import run
from phfmu.sweeps.outcome import Outcome, Stopped
from phfmu.sweeps.places import INPUT, PARAMETER, STATE, Places
from phfmu.sweeps.task import Task


class GeneralRuns:
    """Takes one run after the other, each by an instance that begins with its values."""

    def __init__(self, task: Task, engine: type, keep: Path | None = None):
        self._task, self._engine, places = task, engine, Places(task.model)
        self._keep, self._stopped = keep, False
        self._places = [(p, j) for j, name in enumerate(task.names) for p in places.of(name)]

    def take(self, rows: NDArray[Any], first: int = 0) -> Outcome:
        """Runs with these values (n x names), of which the first has this number."""
        return Outcome.joined([self._one(row, first + i) for i, row in enumerate(np.asarray(rows, float))])

    def stop(self) -> None:
        """From another thread: runs under way end with Stopped."""
        self._stopped = True

    def _goes_on(self, _: float) -> None:
        if self._stopped:
            raise Stopped

    def _one(self, row: NDArray[Any], number: int) -> Outcome:
        task, model = self._task, self._task.model
        values = {PARAMETER: model.p0.copy(), STATE: model.x0.copy(), INPUT: model.u0.copy()}
        for p, column in self._places:
            values[p.kind][p.index] = row[column]
        starts = {"p0": values[PARAMETER], "x0": values[STATE], "u0": values[INPUT]}
        own = replace(model, first=model.first or model, **starts)
        try:
            instance = self._engine(own)
            if task.options.t0 != model.t0:
                instance.set_x(task.options.t0, own.x0)
                instance.initialise()
            stepper = Monolithic(own, instance)
            found = run(stepper, replace(task.options, progress=self._goes_on))
        except (StepFailure, InconsistentState) as error:
            return Outcome(np.full((1, len(task.measures)), np.nan), np.zeros(1, int), np.zeros(1), (str(error),))
        if self._keep is not None:
            found.save(self._keep / f"{number:06d}.parquet")
        told = [m.of(found.time, found.column(m.signal)) for m in task.measures]
        share = found.ledger.summary().share
        return Outcome(np.array([told]).reshape(1, -1), np.array([found.steps]), np.array([share]), ("",))
