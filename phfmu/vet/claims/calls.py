"""Claims of FMI 3.0 about what happens within a step: early return and intermediate update."""

from __future__ import annotations

from typing import Any

from phfmu.fmu.fmi3 import FMU3Library
from phfmu.fmu.importer.refusal import UnitCallError
from phfmu.fmu.isolation.remote_slave import slave_of
from phfmu.vet.finding import ClaimFinding, false, holds, untested
from phfmu.vet.subject import Subject, UnitTrial

OLDER = "FMI 2.0 has none"


def early_return(subject: Subject) -> ClaimFinding:
    """Steps of an instance that may return early, and of one that may not: does it only where that is declared and allowed."""
    if subject.interface.version != "3.0":
        return untested(OLDER)
    with subject.trial() as trial:
        try:
            trial.run(0, subject.n)
        except UnitCallError as error:
            if error.answer == "early return":
                return false(f"it returns early though the importer does not allow it: {error}")
            raise
    trial = UnitTrial(subject, slave_of(subject.archive.extracted, "vetted", True, None))
    try:
        trial.begin()
        for k in range(subject.n):
            trial.step(k)
            end = subject.t0 + k * subject.h + subject.h
            if trial.time < end - 1e-9 * subject.h and not trial.ended:
                if not subject.interface.early_return:
                    return false(f"a step ends at {trial.time:.9g} s, not {end:.9g} s, which it does not declare")
                return holds(f"it returns early at {trial.time:.9g} s where that is allowed, and not where it is not")
            if trial.ended:
                break
    finally:
        trial.close()
    return holds(f"{k + 1} steps, all to their end")


def intermediate_update(subject: Subject) -> ClaimFinding:
    """A callback for intermediate updates: it is called within steps if and only if that is declared."""
    about = subject.interface
    if about.version != "3.0":
        return untested(OLDER)
    wanted = subject.declared.able("providesIntermediateUpdate")
    calls, archive = list[float](), subject.archive

    def update(_environment: Any, time: float, *flags: Any) -> None:
        calls.append(time)
        flags[-2][0] = False  # earlyReturnRequested

    unit = FMU3Library(
        guid=about.token, modelIdentifier=about.identifier, unzipDirectory=str(archive.folder), instanceName="vetted"
    )
    unit.instantiate(logMessage=lambda *_: None, intermediateUpdate=update)
    unit.enterInitializationMode(None, subject.t0, None)
    unit.exitInitializationMode()
    for k in range(8):
        unit.doStep(subject.t0 + k * subject.h, subject.h, True)
    unit.freeInstance()
    if wanted and not calls:
        return false("it declares intermediate updates (providesIntermediateUpdate), and calls for none in 8 steps")
    if calls and not wanted:
        return false(f"it calls for an intermediate update at t = {calls[0]:.6g} s, which it does not declare")
    if not wanted:
        return holds("none is declared, and it calls for none")
    late = max(calls) - subject.t0 - 8 * subject.h
    past = f", up to {late:.2g} s past the end of a step" if late > 1e-6 * subject.h else ""
    return holds(f"{len(calls)} updates in 8 steps{past}")
