"""Claims about steps: it takes those of its experiment, other lengths, unequal ones, and begins anew after a reset."""

from __future__ import annotations

from time import monotonic

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.importer.refusal import UnitCallError
from phfmu.vet.finding import ClaimFinding, false, holds, untested
from phfmu.vet.subject import Subject, UnitTrial, difference
from phfmu.words import counted

Array = NDArray[np.float64]

#: parts of a step that are tried
PARTS = (1, 2, 3)
#: growth of values from a step to a shorter one beyond which it diverges, of their size at the longer one
DIVERGES = 1e3
ORDERS = np.arange(0.25, 6.01, 0.25)


def steps(subject: Subject) -> ClaimFinding:
    """The steps of its experiment, with inputs at their start values; then with inputs that move, which it may refuse."""
    moved, subject.amplitude = subject.amplitude, 0.0
    with subject.trial() as trial:
        begun = monotonic()
        try:
            rows = trial.run(0, subject.n)
        except UnitCallError as error:
            return false(f"it refuses a step of its own experiment, h = {subject.h:.3g} s: {error}")
        subject.pace = (monotonic() - begun) / max(len(rows), 1)
        ended = f"; it asks to end the simulation at t = {trial.time:.6g} s" if trial.ended else ""
    taken = f"{len(rows)} steps of {subject.h:.3g} s are answered with OK{ended}"
    if not subject.inputs:
        return holds(f"{taken}; it has no inputs of type real")
    subject.amplitude = moved
    try:
        with subject.trial() as trial:
            trial.run(0, subject.n)
    except UnitCallError as error:
        subject.amplitude = 0.0
        return holds(f"{taken}; it refuses moved inputs, so these stay as they are in what follows: {error}")
    return holds(f"{taken}, also with {len(subject.inputs)} moved inputs")


def step_sizes(subject: Subject) -> ClaimFinding:
    """h, h/2 and h/3 under the same inputs: how far outputs are apart, and at which rate that falls."""
    base = 6.0 * subject.inside if subject.inside else subject.h
    tables = list[Array]()
    for parts in PARTS:
        try:
            with subject.trial() as trial:
                tables.append(_in_parts(trial, base, parts))
        except UnitCallError as error:
            return untested(f"it refuses steps of {base / parts:.3g} s: {error}")
    n = min(map(len, tables))
    if not n:
        return untested("there was no time for a step")
    scale = np.maximum(np.abs(tables[0][:n]).max(0), 1e-12)
    for parts, table in zip(PARTS[1:], tables[1:], strict=True):
        if not np.isfinite(table).all() or (np.abs(table[:n]).max(0) > DIVERGES * np.maximum(scale, 1.0)).any():
            i = int(np.argmax(np.nan_to_num(np.abs(table[:n]), nan=np.inf).max(0) / scale))
            name = subject.told[i].name
            return false(
                f"it diverges: {name} reaches {np.abs(table[:n, i]).max():.3g} with h/{parts}, {scale[i]:.3g} with h"
            )
    first, second = (np.abs(tables[i][:n] - tables[i + 1][:n]).max(0) / scale for i in (0, 1))
    told = np.array(
        [v.causality == "output" for v in subject.told]
    )  # sums over a step, which are local, change with it
    first = np.where(told, first, 0.0) if first[told].any() else first
    i = int(np.argmax(first)) if len(first) else 0
    if not len(first) or first[i] == 0.0:
        return holds(f"{counted(n, 'step')} of {base:.3g} s, their halves and thirds end with the same bits")
    return holds(
        f"h = {base:.3g} s and h/2 differ by {first[i]:.2g} of {subject.told[i].name}, h/2 and h/3 by "
        f"{second[i]:.2g}{_rate(first[i], second[i])}"
    )


def _in_parts(trial: UnitTrial, h: float, parts: int) -> Array:
    """Values at t0 + (k + 1) h, each step taken in so many parts under the same inputs."""
    subject, rows = trial.subject, list[Array]()
    n = max(1, int(subject.n * subject.h / h / 2.0 + 1e-6))
    for k in range(n):
        if subject.inputs:
            trial.give(subject.values(k))
        for j in range(parts):
            trial.advance(subject.t0 + (k * parts + j) * (h / parts), h / parts)
            if trial.ended:
                break
        rows.append(trial.read())
        if trial.ended or subject.left() < 0:
            break
    return np.array(rows).reshape(len(rows), trial.y.n)


def _rate(first: float, second: float) -> str:
    """The order p with which C h^p explains both differences, in words; empty where none does."""
    if second <= 0.0:
        return ""
    told = (1.0 - 2.0**-ORDERS) / (2.0**-ORDERS - 3.0**-ORDERS)
    ratio = first / second
    if not told[0] <= ratio <= told[-1]:
        return ""
    return f" (rate {ORDERS[int(np.argmin(np.abs(told - ratio)))]:g})"


def unequal_steps(subject: Subject) -> ClaimFinding:
    """Steps of h, h/2, h/3, .. in one run, for a unit that says it can handle these."""
    if not subject.declared.able("canHandleVariableCommunicationStepSize"):
        return untested("it takes steps of one length only")
    lengths = (1.0, 2.0, 3.0) if subject.inside else (1.0, 0.5, 1.0 / 3.0)
    t, longest = subject.t0, 0.0
    with subject.trial() as trial:
        for k in range(subject.n // 2):
            h = lengths[k % 3] * subject.h
            if subject.inputs:
                trial.give(subject.values(k))
            try:
                trial.advance(t, h)
            except UnitCallError as error:
                return false(f"a step of {h:.3g} s after one of {longest:.3g} s is refused: {error}")
            t, longest, values = t + h, h, trial.read()
            if not np.isfinite(values).all():
                name = subject.told[int(np.argmin(np.isfinite(values)))].name
                return false(f"{name} is not finite after a step of {h:.3g} s")
            if trial.ended or subject.left() < 0:
                break
    return holds(f"{counted(k + 1, 'step')} of {', '.join(f'{part * subject.h:.3g}' for part in lengths)} s in turns")


def reset(subject: Subject) -> ClaimFinding:
    """A run; then half a run under other inputs, fmi2Reset or fmi3Reset, and the run again: all values to the bit."""
    with subject.trial() as trial:
        first = trial.run(0, subject.n)
    with subject.trial() as trial:
        for k in range(len(first) // 2):
            trial.step(k, stretch=1.37)
        try:
            trial.slave.reset()
            trial.begin()
            again = trial.run(0, len(first))
        except UnitCallError as error:
            return false(f"after {len(first) // 2} steps: {error}")
    found = difference(subject.told, first, again)
    return false(f"the run after a reset: {found}") if found else holds(f"{len(again)} steps again, equal to the bit")
