"""Claims about instances: what one does depends on its inputs alone, whatever others do and in whatever order it is asked."""

from __future__ import annotations

from threading import Thread

import numpy as np
from numpy.typing import NDArray

from phfmu.vet.finding import ClaimFinding, false, holds, untested
from phfmu.vet.subject import Subject, UnitTrial, difference

Array = NDArray[np.float64]

ALONE = "a process can have one instance of it (canBeInstantiatedOnlyOncePerProcess)"
#: steps in which each variable is read by itself
FEW = 12


def two_instances(subject: Subject) -> ClaimFinding:
    """An instance by itself, then one beside another that is stepped in turns with it under other inputs."""
    if subject.alone:
        return untested(ALONE)
    with subject.trial() as trial:
        first = trial.run(0, subject.n)
    rows = list[Array]()
    with subject.trial() as trial, subject.trial(name="beside") as beside:
        for k in range(len(first)):
            trial.step(k)
            if not beside.ended:
                beside.step(k, stretch=1.37)
            rows.append(trial.read())
            if subject.left() < 0:
                break
    again = np.array(rows)
    found = difference(subject.told, first[: len(again)], again)
    if found:
        return false(f"beside another instance: {found}")
    return holds(f"{len(again)} steps beside another instance: equal to the bit")


def two_processes(subject: Subject) -> ClaimFinding:
    """The same run here and in a process of its own."""
    with subject.trial() as trial:
        first = trial.run(0, subject.n)
    with subject.trial(process=True) as trial:
        again = trial.run(0, len(first))
    n = min(len(first), len(again)) if subject.left() < 0 else len(first)
    found = difference(subject.told, first[:n], again[:n])
    return false(f"in another process: {found}") if found else holds(f"{n} steps in two processes: equal to the bit")


def order_of_calls(subject: Subject) -> ClaimFinding:
    """Inputs set one by one in reverse, variables read one by one in reverse and twice: the same values."""
    with subject.trial() as trial:
        first = trial.run(0, min(FEW, subject.n))
    with subject.trial() as trial:
        given = [trial.slave.references([v]) for v in subject.inputs]
        asked = [trial.slave.references([v]) for v in subject.told]
        rows = list[Array]()
        for k in range(len(first)):
            for r, value in reversed(list(zip(given, subject.values(k), strict=True))):
                r.values[:] = value
                trial.slave.set(r)
            trial.advance(subject.t0 + k * subject.h, subject.h)
            values = np.array([trial.slave.get(r)[0] for _ in range(2) for r in reversed(asked)])
            rows.append(values[len(asked) :][::-1])
    found = difference(subject.told, first, np.array(rows).reshape(len(rows), len(asked)))
    if found:
        return false(f"variables read one by one, in reverse: {found}")
    return holds(f"{len(rows)} steps with {len(asked)} variables read one by one, in reverse, twice: equal to the bit")


def threads(subject: Subject) -> ClaimFinding:
    """Two instances in two threads at the same time, each against a run by itself."""
    if subject.alone:
        return untested(ALONE)
    with subject.trial() as trial:
        first = trial.run(0, subject.n)
    with subject.trial() as one, subject.trial(name="beside") as other:
        runs = [_Run(trial, len(first)) for trial in (one, other)]
        for run in runs:
            run.start()
        for run in runs:
            run.join()
    for run in runs:
        if run.error is not None:
            return false(f"in two threads: {run.error}")
        n = min(len(first), len(run.rows))
        if found := difference(subject.told, first[:n], run.rows[:n]):
            return false(f"in two threads: {found}")
    return holds(f"{len(runs[0].rows)} steps of two instances in two threads: equal to the bit")


class _Run(Thread):
    """The steps of a trial in a thread of their own."""

    def __init__(self, trial: UnitTrial, n: int):
        super().__init__(daemon=True)
        self.trial, self.n, self.rows, self.error = trial, n, np.zeros((0, trial.y.n)), None

    def run(self) -> None:
        try:
            self.rows = self.trial.run(0, self.n)
        except Exception as error:
            self.error = error
