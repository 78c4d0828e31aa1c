"""Claims about partial derivatives: they are those of the outputs by the inputs, and forward and adjoint ones agree.

A unit for Co-Simulation may give the derivative at the present instant, or that of its step; either is accepted and told.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.importer.refusal import UnitCallError
from phfmu.fmu.importer.unit_interface import Scalar
from phfmu.fmu.importer.values import Derivative
from phfmu.fmu.version import VERSIONS
from phfmu.vet.finding import ClaimFinding, false, holds, untested
from phfmu.vet.subject import Subject, UnitTrial
from phfmu.words import counted

Array = NDArray[np.float64]

INSTANT, STEP = "of the instant", "of the step"
#: relative: what differences and derivatives may be apart
TOLERANCE = 1e-4
#: of an input, relative to its size
SHIFT = 1e-4
#: the step in which derivatives are looked at;  most inputs and outputs
AT, MOST = 8, 12


def directional(subject: Subject) -> ClaimFinding:
    """d outputs / d inputs against central differences, of the instant and of the step."""
    if not subject.declared.able("providesDirectionalDerivative", "providesDirectionalDerivatives"):
        return untested("it gives no directional derivatives")
    inputs, outputs = _pairs(subject)
    if not inputs or not outputs or not subject.amplitude:
        return untested("it has no pair of an input and an output of type real that can be moved")
    kinds, unseen = Counter[str](), 0
    with subject.trial() as trial:
        trial.run(0, AT)
        state = trial.save() if trial.interface.saves else None
        trial.step(AT)
        given = _matrix(trial, inputs, outputs)
        found = {INSTANT: _differences(trial, inputs, outputs, None)}
        if state is not None:
            found[STEP] = _differences(trial, inputs, outputs, state)
    if not np.isfinite(given).any():
        return untested("it refuses the derivatives of its outputs with respect to its inputs")
    for i, o in enumerate(outputs):
        row = np.isfinite(given[i])
        if not row.any():
            continue
        kind = next((k for k, d in found.items() if _agree(given[i, row], d[i, row])), None)
        if kind is None and not found[INSTANT][i].any():
            unseen += int(row.sum())  # outputs that a step alone brings up to date: nothing of the instant is seen
        elif kind is None:
            j = int(np.argmax(np.where(row, np.abs(given[i] - found[INSTANT][i]), -1.0)))
            by = ", ".join(f"{d[i, j]:.6g} {k}" for k, d in found.items())
            return false(f"d {o.name} / d {inputs[j].name} = {given[i, j]:.6g}; by differences {by}")
        else:
            kinds[kind] += int(row.sum())
    more = f"{unseen} of outputs that follow no input at once were not seen" if unseen else ""
    if not kinds:
        return untested(more)
    agree = " and ".join(f"{n} {k}" for k, n in kinds.items())
    return holds(f"{agree} agree with differences to {TOLERANCE:g}{'; ' if more else ''}{more}")


def _pairs(subject: Subject) -> tuple[list[Scalar], list[Scalar]]:
    outputs = [v for v in subject.told if v.causality == "output" and v.type == "Float64" and not v.size]
    return [v for v in subject.inputs if v.type == "Float64" and not v.size][:MOST], outputs[:MOST]


def _matrix(trial: UnitTrial, inputs: list[Scalar], outputs: list[Scalar]) -> Array:
    """The derivatives that the unit gives; NaN where it refuses one."""
    version = VERSIONS[trial.interface.version]
    found = np.full((len(outputs), len(inputs)), np.nan)
    for i, o in enumerate(outputs):
        unknown = trial.slave.references([o])
        for j, v in enumerate(inputs):
            try:
                found[i, j] = trial.slave.derivative(Derivative(unknown, v, version))[0]
            except UnitCallError as error:
                if error.answer == "fatal":
                    raise
    return found


def _differences(trial: UnitTrial, inputs: list[Scalar], outputs: list[Scalar], state: int | None) -> Array:
    """Central differences of outputs under moved inputs: now, or over the step AT from the saved state."""
    subject = trial.subject
    y, places = trial.slave.references(outputs), {v.name: j for j, v in enumerate(subject.inputs)}
    u = subject.values(AT)
    found = np.zeros((len(outputs), len(inputs)))
    for j, v in enumerate(inputs):
        ends, width = list[Array](), 0.0
        for sign in (1.0, -1.0):
            moved = u.copy()
            moved[places[v.name]] += sign * SHIFT * subject.scale[places[v.name]]
            moved = subject.clipped(moved)
            width += sign * moved[places[v.name]]
            if state is not None:
                trial.restore(state)
            trial.give(moved)
            if state is not None:
                trial.advance(subject.t0 + AT * subject.h, subject.h)
            ends.append(trial.slave.get(y).copy())
        found[:, j] = (ends[0] - ends[1]) / width if width else np.nan
    if state is None:
        trial.give(u)
    return found


def _agree(given: Array, difference: Array) -> bool:
    scale = np.maximum(np.abs(given), np.abs(difference)).max()
    return bool((np.abs(given - difference) <= TOLERANCE * scale + 1e-9).all())


def adjoint(subject: Subject) -> ClaimFinding:
    """v^T J from the adjoint call against J from the directional one, row by row."""
    if not subject.declared.able("providesAdjointDerivatives"):
        return untested("it gives no adjoint derivatives")
    inputs, outputs = _pairs(subject)
    if not inputs or not outputs:
        return untested("it has no pair of an input and an output of type real")
    with subject.trial() as trial:
        trial.run(0, AT)
        forward = _matrix(trial, inputs, outputs)
        rows = list[Array | None]()
        for o in outputs:
            try:
                rows.append(_adjoint(trial.slave, inputs, o))
            except UnitCallError as error:
                if error.answer == "fatal":
                    raise
                rows.append(None)
    compared = 0
    for i, row in enumerate(rows):
        known = np.isfinite(forward[i])
        if row is None or not known.any():
            continue
        if not _agree(row[known], forward[i, known]):
            j = int(np.argmax(np.where(known, np.abs(row - forward[i]), -1.0)))
            name = f"d {outputs[i].name} / d {inputs[j].name}"
            return false(f"{name} = {row[j]:.6g} by the adjoint call, {forward[i, j]:.6g} by the directional one")
        compared += int(known.sum())
    if not compared:
        return untested("it refuses adjoint or directional derivatives of its outputs with respect to its inputs")
    return holds(f"{counted(compared, 'derivative')} agree with the directional ones")


def _adjoint(slave: Any, inputs: list[Scalar], output: Scalar) -> Array:
    """A row of the Jacobian by fmi3GetAdjointDerivative (inputs)."""
    references = ([output.reference], [v.reference for v in inputs])
    return np.array(slave.call(slave.fmu.getAdjointDerivative, *references, [1.0], len(inputs)))
