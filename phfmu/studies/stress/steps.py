"""Steps of any target: length zero, backwards, very short, very long, in parts, and values that are no numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from phfmu.studies.stress.case import StressCase, StressOutcome
from phfmu.studies.stress.drive import effort, instance, record

STEPS = 20


def cases(name: str, scene: Any) -> tuple[StressCase, ...]:
    """The cases of one scene (its own step h); a start on the constraints is asked for, events are left out."""
    declaration, h = scene.declaration(), scene.step
    made: list[Any] = []

    def unit() -> Any:
        if not made:
            made.append(instance(declaration))
        made[0].reset()
        return made[0]

    moves: list[bool] = []

    def case(what: str, criterion: str, measure: Callable[[], StressOutcome]) -> StressCase:
        def judged() -> StressOutcome:
            if not moves:
                moves.append(moving(unit(), h))
            return replace(measure(), tested=moves[0])

        return StressCase(name, what, criterion, judged)

    return (
        case("h = 0", "state bitwise the same, nothing booked", lambda: nothing(unit(), h)),
        case(f"{STEPS} steps of -h after {STEPS} of h", "back to 1e-10", lambda: reversed_run(unit(), h)),
        case("h = 1e-9 of the scene's", "balance <= 1e-12, same rate as 1e-6 of it to 1e-5", lambda: tiny(unit(), h)),
        *(case(f"h x {f:g}", "balance <= 1e-11, finite, or a typed error", lambda f=f: longer(unit(), f * h))
          for f in (10.0, 100.0, 1000.0)),
        case("one step of 1000 parts", "as 1000 steps: state to 1e-12", lambda: parts(unit(), h)),
        case("a state saved and restored", "the same bits follow", lambda: restored(unit(), h)),
        StressCase(name, "an input that is not a number", "refused, nothing changed", lambda: poisoned(unit(), h)),
    )  # fmt: skip


def size(unit: Any, x: np.ndarray) -> np.ndarray:
    """Natural size of every state: the largest of its variable's values and nominals."""
    out = []
    for v in unit.model.declaration.states:
        place = slice(len(out), len(out) + v.n)
        out += [max(float(np.abs(x[place]).max(initial=0.0)), *v.nominal)] * v.n
    return np.array(out)


def moving(unit: Any, h: float) -> bool:
    """Whether some state changes or some energy flows in the steps that the cases take; True if that cannot be said."""
    from phfmu import StepFailure

    x0 = unit.x
    try:
        r = record(unit, h, STEPS)
    except StepFailure:
        return True
    return bool((r.x != x0).any() or any(np.any(unit.ledger()[k]) for k in ("stored", "dissipated", "supplied")))


def nothing(unit: Any, h: float) -> StressOutcome:
    record(unit, h, 3)
    x, t = unit.x, unit.time
    unit.do_step(t, 0.0)
    same = unit.x.tobytes() == x.tobytes() and unit.time == t
    booked = max(float(np.abs(v).max(initial=0.0)) for v in unit.ledger().values())
    return StressOutcome(f"state {'the same' if same else 'changed'}, {booked:g} J booked", same and booked == 0.0)


def reversed_run(unit: Any, h: float) -> StressOutcome:
    if unit.model.events is not None:
        return StressOutcome("state events happen forwards in time only", None)
    x0, t0 = unit.x, unit.time
    forth = record(unit, h, STEPS, t0)
    unit.run(t0 + STEPS * h, -h, STEPS)
    scale = size(unit, np.maximum(np.abs(x0), np.abs(forth.x).max(axis=0, initial=0.0)))
    off = float((np.abs(unit.x - x0) / scale).max(initial=0.0))
    moved = float((np.abs(forth.x - x0) / scale).max(initial=0.0))
    return StressOutcome(f"moved by {moved:.1e}, came back to {off:.1e} of the states' size", off <= 1e-10)


def tiny(unit: Any, h: float) -> StressOutcome:
    x0 = unit.x
    r = record(unit, 1e-9 * h, STEPS)
    rate = (unit.x - x0) / (STEPS * 1e-9)
    unit.reset()
    record(unit, 1e-6 * h, 1)
    other = (unit.x - x0) / 1e-6
    rounding = np.finfo(float).eps * size(unit, x0) / (STEPS * 1e-9)  # of the state itself
    excess = np.maximum(np.abs(rate - other) - 8 * rounding, 0.0)
    off = float((excess / np.maximum(size(unit, other), 1e-300)).max(initial=0.0))
    return StressOutcome(
        f"balance {r.balance:.1e}, rates {off:.1e} apart beyond rounding; {effort(r)}",
        r.balance <= 1e-12 and off <= 1e-5,
    )


def longer(unit: Any, h: float) -> StressOutcome:
    from phfmu.outcome.status import Status, StepFailure, remedy

    try:
        r = record(unit, h, STEPS)
    except StepFailure as failure:
        return StressOutcome(f"typed error after {unit.counts['steps']} steps: {failure}",
                       failure.status is Status.EVENT or bool(remedy(failure)))  # fmt: skip
    return StressOutcome(f"balance {r.balance:.1e}; {effort(r)}", r.finite and r.balance <= 1e-11)


def parts(unit: Any, h: float) -> StressOutcome:
    n = 1000
    unit.do_step(0.0, h * n, parts=n)
    whole = unit.x
    energy = unit.ledger()["stored"].sum() + sum(e.energy.sum() for e in unit.happened)
    unit.reset()
    r = record(unit, h, n)
    off = float((np.abs(whole - r.x[-1]) / size(unit, r.x)).max(initial=0.0)) if r.x.size else 0.0
    gap = abs(energy - float(np.diff(r.H.sum(axis=1)).sum())) / max(float(np.abs(r.H).sum(axis=1).max()), 1e-300)
    return StressOutcome(f"states {off:.1e} apart, stored energy {gap:.1e} H", off <= 1e-12 and gap <= 1e-10)


def restored(unit: Any, h: float) -> StressOutcome:
    record(unit, h, 3)
    saved, t = unit.get_state(), unit.time
    one = record(unit, h, STEPS, t)
    unit.set_state(saved)
    two = record(unit, h, STEPS, t)
    same = one.x.tobytes() == two.x.tobytes() and one.H.tobytes() == two.H.tobytes()
    return StressOutcome("the same bits" if same else "different bits", same)


def poisoned(unit: Any, h: float) -> StressOutcome:
    from phfmu import StepFailure

    x, said = unit.x, []
    nu = unit.model.step.nu
    for call in (
        lambda: unit.set_input([np.nan] * nu),
        lambda: unit.do_step(np.inf, h),
        lambda: unit.do_step(0.0, np.nan),
    ):
        try:
            call()
        except StepFailure as failure:
            said.append(failure.status.name)
    expected = 3 if nu else 2
    kept = unit.x.tobytes() == x.tobytes()
    return StressOutcome(f"{', '.join(said)}; state {'kept' if kept else 'changed'}", len(said) == expected and kept)
