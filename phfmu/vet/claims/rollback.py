"""Claims about saved states: steps from a restored one, and from its bytes in another instance or process, repeat to the bit."""

from __future__ import annotations

from phfmu.fmu.importer.refusal import UnitCallError
from phfmu.vet.finding import ClaimFinding, false, holds, untested
from phfmu.vet.subject import Subject, UnitTrial, difference

#: steps under other inputs that are taken back
ASTRAY = 9


def state_restored(subject: Subject) -> ClaimFinding:
    """Save, go on, restore, go astray under other inputs, restore, and go on again, twice."""
    at = subject.n // 4
    with subject.trial() as trial:
        if not trial.interface.saves:
            return untested("it does not save its state")
        try:
            trial.run(0, at)
            state, here = trial.save(), trial.read()
            first = trial.run(at, subject.n)
            for turn in ("once", "twice"):
                trial.restore(state)
                there = trial.read()
                if found := difference(subject.told, here[None], there[None]):
                    return false(f"restored {turn}, before any step: {found}")
                _astray(trial, at)
                trial.restore(state)
                again = trial.run(at, at + len(first))
                if found := difference(subject.told, first, again):
                    return false(f"steps after the state was restored {turn}: {found}")
        except UnitCallError as error:
            return false(f"it claims that its state can be restored, but {error}")
    return holds(
        f"{len(first)} steps from a restored state, twice, after {ASTRAY} under other inputs: equal to the bit"
    )


def _astray(trial: UnitTrial, at: int) -> None:
    """Steps under inputs that are those of others; a unit may refuse these."""
    subject = trial.subject
    for k in range(at, at + ASTRAY):
        if subject.inputs:
            trial.give(subject.values(k + 5, 1.3))
        try:
            trial.advance(subject.t0 + k * subject.h, subject.h)
        except UnitCallError as error:
            if error.answer == "fatal":
                raise
            return
        if trial.ended:
            return


def state_as_bytes(subject: Subject) -> ClaimFinding:
    """The bytes of a saved state, in another instance that has gone elsewhere, and in a process that is new."""
    if not subject.declared.able("canSerializeFMUstate", "canSerializeFMUState"):
        return untested("it does not give its state as bytes")
    at = subject.n // 4
    with subject.trial() as trial:
        if not trial.interface.saves:
            return untested("it does not save its state")
        try:
            trial.run(0, at)
            data, time = trial.bytes_of(trial.save()), trial.time
            first = trial.run(at, subject.n)
        except UnitCallError as error:
            return false(f"it claims that its state can be given as bytes, but {error}")
    for process in (False, True):
        where = "a new process" if process else "another instance"
        try:
            with subject.trial(process) as trial:
                trial.run(0, at // 2)
                trial.restore(trial.keep(data), time)
                again = trial.run(at, at + len(first))
        except UnitCallError as error:
            return false(f"in {where}: {error}")
        n = min(len(first), len(again))
        if n < len(first) and subject.left() > 0:
            return false(f"in {where} it ends after {n} steps, not {len(first)}")
        if found := difference(subject.told, first[:n], again[:n]):
            return false(f"steps in {where}: {found}")
    return holds(f"{len(data)} bytes; {len(first)} steps in another instance and in a new process: equal to the bit")
