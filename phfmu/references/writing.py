"""An experiment with its results, put into a unit that is there.

The results are those of the model, stepped by the native engine, not of the unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.switched import stepped
from phfmu.fmu.export.package import write
from phfmu.fmu.export.schedule import UnitEvent
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.archive import checked, opened
from phfmu.fmu.importer.unit_file import unit_file
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.scene import Event
from phfmu.references.experiment import TYPE, Series, UnitExperiment, experiments_text, series_text
from phfmu.references.layer import CSV, FOLDER, MANIFEST, PARAMETER, RESULT, SMOKE_TEST, SSV, LayerFile, manifest
from phfmu.runs.loop import run
from phfmu.runs.options import Options
from phfmu.ssp.writing import parameter_set, values_before

Array = NDArray[np.float64]

#: relative: the same steps elsewhere differ by rounding (1e-16 in a step), of which this leaves room for a growth by 1e10
TOLERANCE = 1e-6
#: rows and numbers of a file of results
ROWS, NUMBERS = 500, 200_000
#: of the largest signal in the same unit of measurement: what stays below is rounding
ROUNDING = 1e-9
#: kinds of signals (`phfmu.signals.SignalKind`) that have a value at an instant, and those that belong to a step
OF_INSTANTS, OF_STEPS = ("state", "end", "port", "energy", "event"), ("mean", "algebraic", "observable")
#: of a step: a time that is a communication point
ON_GRID = 1e-6
_FILES = {
    "experiments": f"{FOLDER}/experiments.exp",
    "parameters": f"{FOLDER}/parameters.ssv",
    "results": f"{FOLDER}/results.csv",
}
_NOTE = "documentation/fmi-ls-ref.txt"


def reference_results(model: Model, step: float, stop: float, events: Sequence[UnitEvent] = ()) -> Series:
    """Signals of the model at communication points (multiples of `step`, s) up to `stop`, with its inputs at their starts.

    `events`: those that the unit has inside.  Rows are as far apart as ROWS and NUMBERS ask; signals that are rounding only
    are left out, and where steps may have an event within them all that belongs to a step, of which a run tells the last part.
    Errors: FMUError if nothing moves; those of a run that does not converge or whose ledger does not close.
    """
    steps = max(1, int(stop / step * (1.0 + 1e-9)))
    apart = ceil(steps / ROWS)
    changes = _on_the_grid([Event(e.t, e.name, e.value) for e in events if e.t < steps * step], step)
    parted = bool(changes or model.declaration.state_events or model.modes)
    every = 1 if parted else apart  # an event has a row before it and one behind
    options = Options(stop=steps * step, step=step, events=changes, every=every)
    result = run(Monolithic(model, stepped(model, NativeInstance)), options)
    place = result.time / step
    apart *= ceil(steps / apart * len(result.names) / NUMBERS)
    kept = np.flatnonzero((np.abs(place - np.round(place)) < ON_GRID) & (np.round(place) % apart == 0))
    kinds = OF_INSTANTS if parted else (*OF_INSTANTS, *OF_STEPS)
    names = [n for n, kind in zip(result.names, result.kinds, strict=True) if kind in kinds]
    columns = {n: result.column(n)[kept] for n in names}
    largest = dict[str, float]()
    for name, values in columns.items():
        unit = result.unit(name)
        largest[unit] = max(largest.get(unit, 0.0), float(np.abs(values).max()))
    told = {n: c for n, c in columns.items() if np.abs(c).max() > ROUNDING * largest[result.unit(n)]}
    if not told:
        raise FMUError(f"{model.name}: all signals stay 0 with inputs at their start values, which is no experiment")
    return Series(result.time[kept], told)


def _on_the_grid(events: Sequence[Event], step: float) -> list[Event]:
    """Events, and others that change nothing, at which a run returns to the steps of a unit.

    The steps of a run begin anew at each event, those of a unit stay multiples of `step`, with the event within one of them.
    """
    back = list[Event]()
    for e in events:
        place = e.t / step
        if abs(place - round(place)) < ON_GRID:
            continue
        end = ceil(place) * step
        latest = max((o for o in events if o.name == e.name and o.t <= end), key=lambda o: o.t)
        back.append(Event(end, e.name, latest.value))
    return sorted([*events, *back], key=lambda e: e.t)


def add_experiment(path: Path, series: Series, step: float, stop: float) -> None:
    """Put the experiment with these results into the unit, with its parameters, a list of the files, and a note about them.

    Columns that are no outputs or local variables of the unit stay away.  FMUError if it has files of FMI-LS-REF already.
    """
    unit = unit_file(path)
    told = unit.interface.variables
    columns = {n: c for n, c in series.columns.items() if n in told and told[n].causality in ("output", "local")}
    for port in unit.port_maps:
        if port.output_sign < 0:  # it counts out of the unit, and into the model
            columns |= {n: -columns[n] for n in (*port.outputs, *port.step_outputs) if n in columns}
    values = values_before(unit)
    names = _FILES if values else {k: v for k, v in _FILES.items() if k != "parameters"}
    experiment = UnitExperiment(
        "held inputs", unit.interface.start, stop, step, TOLERANCE,
        parameters=names.get("parameters", ""), results=names["results"],
    )  # fmt: skip
    files = {
        names["experiments"]: experiments_text(unit.interface.name, [experiment]),
        names["results"]: series_text(Series(series.times, columns)),
        MANIFEST: manifest(_related(names)),
        _NOTE: _note(step, stop).encode(),
    }
    if values:
        files[names["parameters"]] = parameter_set(values, unit, "1.0")
    with opened(path) as archive:
        own = {n: archive.read(n) for n in sorted(checked(archive, path))}
    write(path, own | files)


def _related(names: dict[str, str]) -> list[LayerFile]:
    about = {
        "experiments": (SMOKE_TEST, TYPE, "a run with inputs held at their start values"),
        "parameters": (PARAMETER, SSV, "parameters of that run"),
        "results": (RESULT, CSV, "its results"),
    }
    return [LayerFile(file, *about[what]) for what, file in names.items()]


def _note(step: float, stop: float) -> str:
    return f"""\
Reference experiment
====================

{FOLDER} holds an experiment (experiments.exp) by the drafts FMI-LS-REF 1.0.0-beta.1 and MA-HS-Experiments.

The unit is set to the values of parameters.ssv, if there is such a file; its inputs stay at their start values; it takes
communication steps of {step!r} s from 0 to {stop!r} s. results.csv has values at the end of steps, and those after initialisation
in its first row.

The results come from the model that the unit was made of, stepped outside of a unit in the same steps. Another machine rounds
otherwise, so that values may differ by the tolerance {TOLERANCE:g}, relative to the largest value of each column. Other
steps have another error, which this tolerance does not cover.
"""
