"""Whether and how a unit can take steps back, tried before a run; and how it answers to its inputs, for one that cannot.

Flags of units are wrong in the wild: a saved state may hold less than what the next step depends on.  So steps are taken, taken
back and taken again, in instances of their own, and compared with steps that are never taken back.  Units also differ in what
they make of noSetFMUStatePriorToCurrentPoint, so each is tried in the ways in which a step can be repeated (`REPEAT_MODES`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.importer.reader import FMUInstance
from phfmu.fmu.importer.refusal import UnitCallError, UnitFailure
from phfmu.outcome.status import EndRequested

Array = NDArray[np.float64]

MOVE = 1e-3  # of an input, relative to itself and its nominal value
#: where outputs may be told late: the same of an input, parts of a step, of drifts, of outputs of steps in one part and in two
FAR, SHORT, LATE, SAME_IN_PARTS = 0.1, 1e-4, 10.0, 1e-2
#: trials of a step that is taken again and again, how much more all of them may differ than the first half of them (what goes on
#: from trial to trial: twice), the most that they may differ, and how much more is expected of other steps
AGAIN, STAYS, NEAR, MARGIN = 24, 1.25, 1e-3, 3.0
NEARLY = "takes steps again to a relative {:.1g} only, however often, as solvers with steps of their own do"
REPEATS = 1e-9  # values that differ by less, relative to the largest of the variable, are taken again well enough


@dataclass(frozen=True)
class RepeatMode:
    """Mode in which a step is repeated: the noSetFMUStatePriorToCurrentPoint that trials are told, and whether the accepted
    trial is taken once more with True, since the unit keeps nothing of a step that was told False.
    """

    no_set_prior: bool
    once_more: bool = False


REPEATED = "a step repeated from a restored state"
AFTER = "a step after others were taken back"

#: True is so, as states are restored to the start of the step only; some units then restore nothing, and others move on only so
REPEAT_MODES = (RepeatMode(True), RepeatMode(False), RepeatMode(False, once_more=True))


@dataclass(frozen=True)
class Rollback:
    """Rollback of a unit to the start of a step, as it was tried.

    works:  whether couplings that repeat steps may do so, in this `way`
    words:  what is wrong, or not as it should be; else empty
    late:   what `tells_late` said
    repeated: relative difference that steps taken again may have, 0: rounding
    """

    works: bool
    words: str = ""
    way: RepeatMode = REPEAT_MODES[0]
    late: bool = False
    repeated: float = 0.0


def try_rollback(make: Callable[[], FMUInstance], h: float) -> Rollback:
    """The first way in which steps that are taken back leave nothing behind; if there is none, what is wrong with the first."""
    with make() as unit:
        if not unit.interface.saves:
            return Rollback(False, "cannot save its state")
        unit.steps.no_set_prior = True
        ahead = _RepeatedSteps(unit, h)
        try:
            ahead.take(0, ahead.u)
            straight = [ahead.take(k, ahead.moved) for k in (1, 2)]
        except EndRequested:  # there is nothing to be repeated
            return Rollback(True)
    tried = list[Rollback]()
    for way in REPEAT_MODES:
        with make() as unit:
            tried.append(_try(unit, h, way, straight))
        if tried[-1].works:
            return tried[-1]
    for way in REPEAT_MODES[:2]:
        with make() as unit:
            if (left := _wanders(unit, h, way)) > 0.0:
                return Rollback(True, NEARLY.format(left), way, repeated=MARGIN * left)
    return tried[0]


def _wanders(unit: FMUInstance, h: float, way: RepeatMode) -> float:
    """The largest relative difference of a step that is taken again and again, if it is small and stays as it is; else 0.

    Solvers inside a unit may keep the length of their last step, which is in no saved state: steps taken again differ by less
    than these solvers' own error, however often.  What a unit has forgotten of its state goes on from trial to trial instead.
    """
    steps = _RepeatedSteps(unit, h, way)
    try:
        steps.accept(0, steps.u)
        steps.begin()
        found = []
        for _ in range(AGAIN):
            found.append(steps.take(1, steps.moved))
            steps.back()
    except (UnitCallError, UnitFailure, EndRequested):
        return 0.0
    values = np.array(found)
    size = np.maximum(np.abs(values).max(axis=0), np.finfo(float).tiny)
    half, whole = (np.ptp(v, axis=0) / size for v in (values[: AGAIN // 2], values))
    left = float(whole.max())
    return left if (whole <= STAYS * half + REPEATS).all() and left <= NEAR else 0.0


def _try(unit: FMUInstance, h: float, way: RepeatMode, straight: list[Array]) -> Rollback:
    """Steps as `straight`, of which the second is repeated: in between it is taken under other inputs."""
    steps = _RepeatedSteps(unit, h, way)
    try:
        steps.begin()
        steps.accept(0, steps.u)
        steps.begin()
        first = steps.take(1, steps.moved)
        steps.back()
        steps.take(1, steps.u)
        steps.back()
        again = steps.accept(1, steps.moved)
        steps.begin()
        after = steps.accept(2, steps.moved)
    except (UnitCallError, UnitFailure, EndRequested) as error:
        return Rollback(False, f"does not restore its state: {error}", way)
    found = _judged(steps.names, first, again)
    if not found.works:
        return replace(found, way=way)
    ends = [_judged(steps.names, *pair, how=AFTER) for pair in zip(straight, (again, after), strict=True)]
    worst = next((e for e in ends if not e.works), found)
    return replace(worst, way=way)


class _RepeatedSteps:
    """Steps of a unit, number k from t0 + k h, and what it tells of them; `moved`: inputs beside those of the start."""

    def __init__(self, unit: FMUInstance, h: float, way: RepeatMode = REPEAT_MODES[0]):
        self._unit, self._h, self._way, self._t0 = unit, h, way, unit.time
        self._told = [n for n in unit.names if unit.variable(n).causality != "input"]
        self.names = [*self._told, *(f"mean of {n}" for n in unit.outputs)]
        self.u = unit.start_inputs()
        self.moved = _moved(unit, self.u)
        unit.steps.no_set_prior = way.no_set_prior

    def begin(self) -> None:
        self._state = self._unit.get_state()

    def back(self) -> None:
        self._unit.set_state(self._state)

    def take(self, k: int, inputs: Array) -> Array:
        self._unit.set_input(inputs)
        self._unit.do_step(self._t0 + k * self._h, self._h)
        return np.concatenate([self._unit.get(self._told), self._unit.output()])

    def accept(self, k: int, inputs: Array) -> Array:
        """Take a step, once more where the mode asks for that."""
        found = self.take(k, inputs)
        if not self._way.once_more:
            return found
        self.back()
        self._unit.steps.no_set_prior = True
        found = self.take(k, inputs)
        self._unit.steps.no_set_prior = self._way.no_set_prior
        return found


def unsteady(unit: FMUInstance, h: float, repeated: float = 0.0) -> str:
    """The difference when a step of length h is taken twice from here, in words; "" if it is at most `repeated`.

    The unit is back afterwards, as far as it can.
    """
    state, t = unit.get_state(), unit.time
    names = [n for n in unit.names if unit.variable(n).causality != "input"]
    found = []
    for _ in range(2):
        unit.set_state(state)
        unit.do_step(t, h)
        found.append(np.concatenate([unit.get(names), unit.output()]))
    unit.set_state(state)
    judged = _judged([*names, *(f"mean of {n}" for n in unit.outputs)], *found, most=max(repeated, REPEATS))
    return "" if judged.works else judged.words


def _judged(names: list[str], first: Array, again: Array, how: str = REPEATED, most: float = REPEATS) -> Rollback:
    if np.array_equal(first, again, equal_nan=True):
        return Rollback(True)
    change = np.abs(again - first) / np.maximum(np.maximum(np.abs(first), np.abs(again)), np.finfo(float).tiny)
    i = int(np.argmax(np.nan_to_num(change, nan=np.inf)))
    if change[i] <= most:
        return Rollback(True, f"restores its state to a relative {change[i]:.1g} only (worst: {names[i]})")
    told = f"{how} ends with {names[i]} = {again[i]:.9g}, not {first[i]:.9g}"
    return Rollback(False, f"does not restore its state: {told}")


def response(make: Callable[[], FMUInstance], h: float) -> tuple[Array, Array]:
    """The response in the first step: mean outputs (nu) and their derivatives by the held inputs (nu x nu), an instance each."""

    def means(j: int | None) -> tuple[Array, float]:
        with make() as unit:
            u, move = unit.start_inputs(), 0.0
            if j is not None:
                move = _moved(unit, u)[j] - u[j]
                u[j] += move
            unit.set_input(u)
            unit.do_step(unit.time, h)
            return unit.output().copy(), move

    base, _ = means(None)
    G = np.zeros((len(base), len(base)))
    for j in range(len(base)):
        y, move = means(j)
        G[:, j] = (y - base) / move
    return base, G


def tells_late(make: Callable[..., FMUInstance], h: float) -> bool:
    """Whether outputs of ports follow inputs at once, but are told so only after a step, and steps may be taken in two parts.

    Many libraries compute outputs within doStep only.  What they tell at the start of a step belongs to the inputs of the step
    before then, and the mean of it and of the output at the end would be of first order.  Here all inputs change after a step
    of length h: what a short step makes of the outputs beside their drift, and reading them before it did not, is told late.
    Parts are not taken where they end with other outputs than the whole step, as in units with steps of their own inside.
    """
    try:
        with make() as unit:
            if unit.interface.one_step or not unit.nu or unit.rated:
                return False
            short, names = SHORT * h, unit.outputs
            u = unit.start_inputs()
            unit.set_input(u)
            unit.do_step(unit.time, h)
            unit.set_input(_moved(unit, u, FAR))
            at = [unit.get(names)]
            for _ in range(2):
                unit.do_step(unit.time, short)
                at.append(unit.get(names))
            drift = np.abs(at[2] - at[1])
            jump = np.abs(at[1] - at[0]) - drift
            if not (jump > LATE * drift + REPEATS * np.abs(at[1])).any():
                return False
        ends = [_end(make, h, in_parts) for in_parts in (False, True)]
    except (UnitCallError, UnitFailure, EndRequested):
        return False
    size = np.maximum(np.abs(ends[0]), np.abs(ends[1]))
    return bool((np.abs(ends[1] - ends[0]) <= SAME_IN_PARTS * size).all())


def _end(make: Callable[..., FMUInstance], h: float, in_parts: bool) -> Array:
    """Outputs of ports after a first step."""
    with make(in_parts=in_parts) as unit:
        unit.set_input(unit.start_inputs())
        unit.do_step(unit.time, h)
        return unit.get(unit.outputs)


def _moved(unit: FMUInstance, u: Array, part: float = MOVE) -> Array:
    nominal = np.abs(unit.input_sign) * np.array([unit.variable(n).nominal for n in unit.inputs])
    return u + part * (np.abs(u) + nominal)
