"""The claim that the experiments which a unit brings along (FMI-LS-REF) give the results that it tells.

An experiment file tells experiments; where there is none, a file with the role `result` is taken as that of the unit's default
experiment, as the Reference FMUs of the Modelica Association mean it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu import limits
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.refusal import UnitCallError
from phfmu.fmu.importer.unit_file import unit_file
from phfmu.fmu.importer.unit_interface import Scalar
from phfmu.references.experiment import TYPES, Series, UnitExperiment, read_experiments, read_series
from phfmu.references.layer import CSV, EXPERIMENT, PARAMETER, RESULT, SSV, content, related
from phfmu.ssp.flat import bound
from phfmu.ssp.loading import with_values
from phfmu.ssp.parameters import parameter_values
from phfmu.ssp.structure import SSPError
from phfmu.vet.finding import FALSE, HOLDS, Claim, ClaimFinding, false, holds, untested
from phfmu.vet.subject import Subject, UnitTrial
from phfmu.words import counted, first_few

Array = NDArray[np.float64]

#: relative: where neither an experiment nor the unit tells one; by this results of the Modelica Standard Library are verified
TOLERANCE = 2e-3
#: of a step: a time of the results that is a communication point
ROUNDING = 1e-6
#: bytes of a table
LONGEST = limits.DESCRIPTION


@dataclass(frozen=True)
class _Task:
    """An experiment with what its files hold: start values by name, stimuli, results; `notes`: what was left out."""

    experiment: UnitExperiment
    starts: Mapping[str, float]
    stimuli: Series | None
    results: Series
    notes: tuple[str, ...]


def results(subject: Subject) -> ClaimFinding:
    """Each experiment is run, and each parameter set by itself is set; false if one of them is contradicted.

    FMUError where the unit has no library for this machine.
    """
    _ = subject.archive.library
    try:
        files = related(subject.path)
        if not files:
            return untested("it brings along no files by FMI-LS-REF")
        experiments = [
            e for f in files if f.type in TYPES and f.main_role == EXPERIMENT for e in _told(subject, f.name)
        ]
        if not experiments:
            plain = [f for f in files if f.main_role == RESULT and f.type == CSV]
            experiments = [UnitExperiment(f.description or f.name, results=f.name) for f in plain]
        used = {e.parameters for e in experiments}
        sets = [f.name for f in files if f.main_role == PARAMETER and f.type == SSV and f.name not in used]
        found = [_experiment(subject, e) for e in experiments] + [_set_by_itself(subject, name) for name in sets]
    except (FMUError, SSPError) as error:
        return false(f"its files by FMI-LS-REF cannot be read: {error}")
    if not found:
        return untested(
            f"of {counted(len(files), 'file')} by FMI-LS-REF none is an experiment, a result or a parameter set"
        )
    verdicts = [f.verdict for f in found]
    seen = "; ".join(f.seen for f in sorted(found, key=lambda f: f.verdict != FALSE))
    return ClaimFinding(next((v for v in (FALSE, HOLDS) if v in verdicts), found[0].verdict), seen)


def _told(subject: Subject, file: str) -> list[UnitExperiment]:
    data = content(subject.path, file)
    missing = [UnitExperiment(file, why=f"the unit names {file} and does not hold it")]
    return missing if data is None else read_experiments(data, file)


def _experiment(subject: Subject, e: UnitExperiment) -> ClaimFinding:
    """One experiment: untested where it has no results or is none that can be run here."""
    name = f"experiment '{e.name}'"
    if e.why or not e.results:
        return untested(f"{name}: {e.why or 'it tells no results'}")
    about = subject.interface
    filled = replace(
        e,
        start=about.start if e.start is None else e.start,
        stop=about.stop if e.stop is None else e.stop,
        step=e.step or about.step,
    )
    data = {file: content(subject.path, file, LONGEST) for file in (e.parameters, e.stimuli, e.results) if file}
    if lost := [file for file, bytes_ in data.items() if bytes_ is None]:
        return untested(f"{name}: the unit names {lost[0]} and does not hold it")
    notes = list[str]()
    starts = _starts(subject, e.parameters, notes) if e.parameters else {}
    stimuli, told = (read_series(data[f] or b"", f) if f else None for f in (e.stimuli, e.results))
    assert told is not None
    return _compared(subject, _Task(filled, starts, stimuli, told, tuple(notes)), name)


def _starts(subject: Subject, file: str, notes: list[str]) -> Mapping[str, float]:
    """The values of a parameter set in the unit's own units of measurement; names that the unit has not are told."""
    given = parameter_values(content(subject.path, file) or b"", file, notes)
    return dict(with_values(file, unit_file(subject.path), bound((given,)), notes).starts)


def _set_by_itself(subject: Subject, file: str) -> ClaimFinding:
    """A parameter set that no experiment uses: the unit takes its values and a step."""
    notes = list[str]()
    if content(subject.path, file) is None:
        return untested(f"parameter set {file}: the unit names it and does not hold it")
    starts = _starts(subject, file, notes)
    try:
        with subject.trial(begin=False) as trial:
            _begin(trial, subject.t0, None, starts)
            trial.advance(subject.t0, subject.h)
    except UnitCallError as error:
        return false(f"parameter set {file}: {error}")
    return holds("; ".join([f"parameter set {file}: {counted(len(starts), 'value')} taken", *notes]))


def _begin(trial: UnitTrial, start: float, tolerance: float | None, values: Mapping[str, float]) -> None:
    trial.slave.enter(start, None, tolerance)
    if values:
        group = trial.slave.references([trial.interface.variables[n] for n in values])
        group.values[:] = list(values.values())
        trial.slave.set(group)


def _compared(subject: Subject, task: _Task, name: str) -> ClaimFinding:
    """The run of an experiment against its results."""
    e, told = task.experiment, task.results
    variables = subject.interface.variables
    chosen = [variables[n] for n in told.columns if n in variables and variables[n].causality != "independent"]
    unknown = [n for n in told.columns if n not in variables]
    if not chosen:
        return false(
            f"{name}: none of its columns ({first_few(unknown or list(told.left_out))}) is a variable of the unit"
        )
    notes = [*task.notes, *([f"not its variables: {first_few(unknown)}"] if unknown else [])]
    notes += [f"no numbers: {first_few(list(told.left_out))}"] if told.left_out else []
    start = told.times[0] if e.start is None else e.start
    apart = np.diff(np.unique(told.times))
    step = e.step or (float(apart.min()) if len(apart) else subject.h)
    place = (told.times - start) / step
    points = np.round(place).astype(np.int64)
    hit = (np.abs(place - points) <= ROUNDING * np.maximum(1.0, place)) & (points >= 0)
    if e.stop is not None:
        hit &= points <= int((e.stop - start) / step * (1.0 + 1e-12) + ROUNDING)
    if not hit.any():
        return untested(
            f"{name}: no time of its results is one of its communication points, {start:g} s and {step:g} s apart"
        )
    wanted = np.unique(points[hit])
    try:
        low, high = _run(subject, task, chosen, start, step, wanted)
    except UnitCallError as error:
        return false(f"{name}: {error}")
    return _judged(
        task, name, chosen, _Rows(start, step, wanted, points, hit, low, high), subject.declared.tolerance, notes
    )


@dataclass(frozen=True)
class _Rows:
    """`wanted`: communication points (n,) that results have rows at; `points`, `hit` (rows): those of the rows.

    `low`, `high` (up to n, variables): values of the unit before and after the inputs of a point are set, in order of size.
    """

    start: float
    step: float
    wanted: NDArray[np.int64]
    points: NDArray[np.int64]
    hit: NDArray[np.bool_]
    low: Array
    high: Array


def _run(
    subject: Subject, task: _Task, chosen: Sequence[Scalar], start: float, step: float, wanted: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Values at the communication points `wanted`, as many as there is time for: the lower and the upper ones."""
    stimuli, tables = task.stimuli, (list[Array](), list[Array]())
    variables = subject.interface.variables
    inputs = [variables[n] for n in stimuli.columns if n in variables] if stimuli else []
    with subject.trial(begin=False) as trial:
        _begin(trial, start, task.experiment.tolerance, task.starts)
        fed, seen = trial.slave.references(inputs), trial.slave.references(chosen)

        def feed(t: float) -> None:
            if stimuli and inputs:
                fed.values[:] = [_at(stimuli, v, t) for v in inputs]
                trial.slave.set(fed)

        feed(start)
        trial.slave.leave()
        listed = {*wanted.tolist()}
        for k in range(int(wanted[-1]) + 1):
            if k:
                trial.advance(start + (k - 1) * step, step)
            before = trial.slave.get(seen).copy() if k in listed else None
            if not trial.ended:
                feed(start + k * step)
            if before is not None:
                after = trial.slave.get(seen).copy() if inputs and not trial.ended else before
                tables[0].append(np.minimum(before, after))
                tables[1].append(np.maximum(before, after))
            if trial.ended or subject.left() < 0:
                break
    low, high = (np.array(t).reshape(len(t), len(chosen)) for t in tables)
    return low, high


def _at(stimuli: Series, v: Scalar, t: float) -> float:
    """The value of an input at time t: on straight lines for continuous ones, else the last one that was given."""
    times, values = stimuli.times, stimuli.columns[v.name]
    last = int(np.clip(np.searchsorted(times, t + 1e-12 * max(1.0, abs(t)), "right") - 1, 0, len(times) - 1))
    if v.type not in ("Float64", "Float32") or v.variability == "discrete" or last == len(times) - 1:
        return float(values[last])
    part = np.clip((t - times[last]) / (times[last + 1] - times[last]), 0.0, 1.0)
    return float(values[last] + part * (values[last + 1] - values[last]))


def _judged(
    task: _Task, name: str, chosen: Sequence[Scalar], rows: _Rows, own: float | None, notes: Sequence[str]
) -> ClaimFinding:
    """The furthest value against the tolerance, relative to the largest value of its column in the results.

    Rows of one time, at an event, stand for all values between them.
    """
    told = np.column_stack([task.results.columns[v.name] for v in chosen])
    size = np.abs(told[rows.hit]).max(0)
    scale = np.where(size > 0.0, size, [abs(v.nominal) or 1.0 for v in chosen])
    n = len(rows.low)
    least, most = (np.full((len(rows.wanted), len(chosen)), sign * np.inf) for sign in (1.0, -1.0))
    at = np.searchsorted(rows.wanted, rows.points[rows.hit])
    np.minimum.at(least, at, told[rows.hit])
    np.maximum.at(most, at, told[rows.hit])
    apart = np.maximum(np.maximum(least[:n] - rows.high, rows.low - most[:n]), 0.0) / scale
    apart = np.where(np.isfinite(rows.low) & np.isfinite(rows.high), apart, np.inf)
    k, i = divmod(int(np.argmax(apart)), len(chosen))
    tolerance = task.experiment.tolerance or own
    taken = f"tolerance {tolerance:g}" if tolerance else f"tolerance {TOLERANCE:g}, as none is told"
    tolerance = tolerance or TOLERANCE
    left = f"; {counted(len(rows.wanted) - n, 'row')} not reached" if n < len(rows.wanted) else ""
    skipped = int((~rows.hit).sum())
    left += f"; {counted(skipped, 'row')} between its steps of {rows.step:g} s not compared" if skipped else ""
    left += "".join(f"; {line}" for line in notes)
    furthest, column = float(apart[k, i]), chosen[i].name
    if furthest > tolerance:
        value, told_value = (rows.low[k, i], least[k, i])
        t = rows.start + int(rows.wanted[k]) * rows.step
        return false(
            f"{name}: {column} = {value:.9g}, not {told_value:.9g}, at t = {t:.9g} s: {furthest:.2g} of its largest value "
            f"({taken}){left}"
        )
    return holds(
        f"{name}: {counted(n, 'time')} of {counted(len(chosen), 'variable')}, furthest {column} by {furthest:.2g} of its largest "
        f"value ({taken}){left}"
    )


CLAIM = Claim("reference results", "experiments that it brings along (FMI-LS-REF), run, against their results", results)
