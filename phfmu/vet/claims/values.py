"""Claims about values: starts and parameters are kept, values are finite, change with time and inputs only, and follow inputs
at once only where that is declared.
"""

from __future__ import annotations

import numpy as np

from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.refusal import UnitCallError
from phfmu.fmu.importer.unit_interface import Scalar
from phfmu.fmu.importer.values import References
from phfmu.vet.finding import ClaimFinding, false, holds, untested
from phfmu.vet.subject import MOVE, Subject, UnitTrial, difference
from phfmu.words import counted, first_few

#: relative: a start that a unit computes in another unit of measurement is rounded
ROUNDING = 1e-12
#: parameters that are moved, each in an instance of its own, and by how much of their value
MOVED, SHIFT = 24, 1e-3
#: growth of a value beyond which OK is no answer, of its nominal value
GROWTH = 1e30
LONGEST = 2000
#: steps between looks; the step before which inputs are moved
FEW, AT = 4, 6


def start_values(subject: Subject) -> ClaimFinding:
    """After initialisation: parameters, inputs and variables that begin exactly at a start value have it."""
    exact = [v for v in subject.interface.variables.values() if _begins_at_start(subject, v)]
    if not exact:
        return untested("no variable of type real begins at a start value of its description")
    with subject.trial() as trial:
        values = trial.slave.get(trial.slave.references(exact)).copy()
    wrong = [
        f"{v.name} = {value:.9g}, not {v.start:.9g}"
        for v, value in zip(exact, values, strict=True)
        if v.start is not None and not _near(value, v.start, v.type)
    ]
    if wrong:
        return false(f"{counted(len(wrong), 'variable')} of {len(exact)}: {first_few(wrong)}")
    return holds(f"{counted(len(exact), 'variable')} begin at the start value of the description")


def _begins_at_start(subject: Subject, v: Scalar) -> bool:
    if v.start is None or v.type not in ("Float64", "Float32") or v.causality == "independent":
        return False
    initial = subject.declared.initial.get(v.name.partition("[")[0], "")
    return v.causality in ("parameter", "input") and initial in ("", "exact") or initial == "exact"


def _near(value: float, start: float, type_: str) -> bool:
    return abs(value - start) <= (1e-6 if type_ == "Float32" else ROUNDING) * max(abs(start), abs(value))


def parameters_kept(subject: Subject) -> ClaimFinding:
    """A parameter that is set before the start reads back as it was set, also after steps."""
    chosen = [
        v
        for v in subject.interface.variables.values()
        if v.causality == "parameter" and v.type == "Float64" and v.start is not None and not v.size
    ][:MOVED]
    kept, refused = 0, list[str]()
    for v in chosen:
        low, high = subject.declared.limits.get(v.name, (None, None))
        value = (v.start or 0.0) * (1.0 + SHIFT) if v.start else SHIFT * abs(v.nominal)
        value = max(value, low) if low is not None else value
        value = min(value, high) if high is not None else value
        if subject.left() < 0:
            break
        with subject.trial(begin=False) as trial:
            r = trial.slave.references([v])
            try:
                trial.slave.enter(subject.t0, None, None)
                r.values[:] = value
                trial.slave.set(r)
                trial.slave.leave()
                trial.run(0, 2)
                found = trial.slave.get(r)[0]
            except (UnitCallError, FMUError):
                refused.append(v.name)
                continue
        if not _near(found, value, v.type):
            return false(f"{v.name} is set to {value:.9g} before the start and reads {found:.9g} after two steps")
        kept += 1
    if not kept:
        return untested("it has no parameter that it lets be set" if chosen else "it has no parameters of type real")
    more = f"; it refuses another value of {first_few(refused)}" if refused else ""
    return holds(f"{counted(kept, 'parameter')} read back as set{more}")


def finite_values(subject: Subject) -> ClaimFinding:
    """Steps of the whole experiment, as far as there is time: every value that comes with OK is finite and of sensible size."""
    n = LONGEST if subject.span is None else min(LONGEST, max(subject.n, round(subject.span / subject.h)))
    bound = np.array([GROWTH * max(1.0, abs(v.nominal), abs(v.start or 0.0)) for v in subject.told])
    with subject.trial() as trial:
        for k in range(n):
            try:
                trial.step(k)
            except UnitCallError as error:
                return holds(f"{k} steps, then it says itself that it cannot go on: {error}")
            values = trial.read()
            wrong = ~(np.abs(values) < bound)
            if wrong.any():
                i = int(np.argmax(wrong))
                return false(f"it answers OK with {subject.told[i].name} = {values[i]:.6g} at t = {trial.time:.6g} s")
            if trial.ended or subject.left() < 0:
                break
    return holds(f"{k + 1} steps up to t = {trial.time:.6g} s")


def unchanged_at_rest(subject: Subject) -> ClaimFinding:
    """Without time or inputs nothing changes: values are read twice, and again after the same inputs are set again."""
    with subject.trial() as trial:
        for k in range(0, 3 * FEW, FEW):
            first, again = trial.read(), trial.read()
            if subject.inputs:
                trial.give(trial.slave.get(trial.u).copy())
            third = trial.read()
            for how, values in (("read twice", again), ("after its inputs were set to what they were", third)):
                if found := difference(subject.told, first[None], values[None]):
                    return false(f"{how} at t = {trial.time:.6g} s: {found.partition(', after')[0]}")
            trial.run(k, k + FEW)
            if trial.ended:
                break
    return holds("values read twice, and after the same inputs were set again, are equal to the bit")


def feedthrough(subject: Subject) -> ClaimFinding:
    """Each input is moved between steps: outputs that follow at once are those whose dependencies say so."""
    outputs = [v for v in subject.told if v.causality == "output" and v.type in ("Float64", "Float32")]
    if not subject.inputs or not outputs or not subject.amplitude:
        return untested("it has no inputs and outputs of type real that can be moved")
    undeclared, absent, found = list[str](), 0, 0
    with subject.trial() as trial:
        trial.run(0, AT)
        y = trial.slave.references(outputs)
        for j, v in enumerate(subject.inputs):
            changed = _follows(trial, y, j)
            for o, follows in zip(outputs, changed, strict=True):
                declared = subject.declared.dependencies.get(o.name.partition("[")[0])
                if declared is None:
                    found += int(follows)
                elif follows and v.name.partition("[")[0] not in declared:
                    undeclared.append(f"{o.name} follows {v.name}")
                else:
                    found += int(follows)
                    absent += int(v.name.partition("[")[0] in declared and not follows)
            if subject.left() < 0:
                break
    if undeclared:
        return false(f"at once, though its dependencies deny it: {first_few(undeclared)}")
    more = f"; {absent} that are declared were not seen" if absent else ""
    if not found:
        return holds(f"no output follows an input at once{more}")
    return holds(
        f"{counted(found, 'pair')} of an output that follows an input at once, all declared or left open{more}"
    )


def _follows(trial: UnitTrial, y: References, j: int) -> np.ndarray:
    """Mask of the outputs that change as input j is moved between steps; it is moved back."""
    subject = trial.subject
    u = trial.slave.get(trial.u).copy()
    before = trial.slave.get(y).copy()
    moved = u.copy()
    moved[j] += MOVE * subject.scale[j]
    moved = subject.clipped(moved)
    if moved[j] == u[j]:
        moved[j] -= MOVE * subject.scale[j]
        moved = subject.clipped(moved)
    trial.give(moved)
    changed = trial.slave.get(y) != before
    trial.give(u)
    return changed


def input_timing(subject: Subject) -> ClaimFinding:
    """An input is moved before one step only: which outputs answer at once, by the end of that step, or a step later."""
    outputs = [v for v in subject.told if v.causality == "output" and v.type in ("Float64", "Float32")]
    if not subject.inputs or not outputs or not subject.amplitude:
        return untested("it has no inputs and outputs of type real that can be moved")
    told = list[str]()
    for j, v in enumerate(subject.inputs[:6]):
        base, moved = (_answers(subject, outputs, j, move) for move in (False, True))
        changed = base != moved
        counts = [int(changed[0].sum()), int((changed[1] & ~changed[0]).sum())]
        counts.append(int((changed[2] & ~changed[1] & ~changed[0]).sum()))
        words = ("at once", "by the end of the step", "a step later")
        parts = [f"{n} {w}" for n, w in zip(counts, words, strict=True) if n]
        told.append(f"{v.name}: {', '.join(parts) or 'no output within two steps'}")
    return holds(f"outputs that answer to {'; '.join(told)}")


def _answers(subject: Subject, outputs: list[Scalar], j: int, move: bool) -> np.ndarray:
    """Outputs after input j is set, after the step, and after one more with the input back (3 x outputs)."""
    rows = list[np.ndarray]()
    with subject.trial() as trial:
        y = trial.slave.references(outputs)
        trial.run(0, AT)
        u = trial.slave.get(trial.u).copy()
        given = u.copy()
        given[j] += MOVE * subject.scale[j] * move
        trial.give(subject.clipped(given))
        rows.append(trial.slave.get(y).copy())
        for k in (AT, AT + 1):
            trial.advance(subject.t0 + k * subject.h, subject.h)
            rows.append(trial.slave.get(y).copy())
            trial.give(subject.clipped(u))
    return np.array(rows)
