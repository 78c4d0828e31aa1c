"""Experiments of a unit: times, step, parameters, stimuli and the results to be found.

They are told by files of the type `application/x-ma-hs-experiments` (.exp).  Two drafts are read: times as attributes of
`UnitExperiment`, and of its child `TransientSimulation`, which is the newer one and is written.
Source: github.com/modelica/ma-hs-experiments, schema/maHarmonizedSpecificationExperiments.xsd.
"""

from __future__ import annotations

import csv
import posixpath
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.words import plain
from phfmu.fmu.xml import Element, etree, number, parse, text_of
from phfmu.references.layer import CSV, SSV, inside

Array = NDArray[np.float64]

TYPE = "application/x-ma-hs-experiments"
#: its name before the format had a document of its own
TYPES = (TYPE, "application/x-ma-ls-experiments")
_TRANSIENT = "TransientSimulation"
_TRUTH = {"true": 1.0, "false": 0.0}


@dataclass(frozen=True)
class UnitExperiment:
    """A run of a unit from `start` to `stop` in communication steps of `step`, s; None where the unit's own are meant.

    `tolerance`: relative; None where none is told.  `parameters`, `stimuli`, `results`: names of files in the archive, ""
    where there is none; `why`: the reason for which it cannot be run here, in words.
    """

    name: str
    start: float | None = None
    stop: float | None = None
    step: float | None = None
    tolerance: float | None = None
    parameters: str = ""
    stimuli: str = ""
    results: str = ""
    why: str = ""


@dataclass(frozen=True)
class Series:
    """Values over time: `times` (rows), s, and columns (rows) by the names of scalars; names of columns without numbers."""

    times: Array
    columns: Mapping[str, Array]
    left_out: tuple[str, ...] = ()


def experiments_text(name: str, experiments: Sequence[UnitExperiment]) -> bytes:
    """The file of these experiments; the files that they name are in its folder."""
    root = etree.Element("Experiments", name=name)
    for e in experiments:
        element = etree.SubElement(root, "Experiment", name=e.name)
        if e.tolerance is not None:
            element.set("tolerance", number(e.tolerance))
        run = etree.SubElement(element, _TRANSIENT)
        for word, value in (("startTime", e.start), ("stopTime", e.stop), ("stepSize", e.step)):
            if value is not None:
                run.set(word, number(value))
        named = (("Parameters", SSV, e.parameters), ("Stimuli", CSV, e.stimuli), ("References", CSV, e.results))
        for tag, type_, file in named:
            if file:
                etree.SubElement(element, tag, type=type_, source=posixpath.basename(file))
    return text_of(root)


def read_experiments(data: bytes, file: str) -> list[UnitExperiment]:
    """The experiments that `file` of a unit tells; FMUError for what is none."""
    root = parse(data, file)
    if root.tag != "Experiments":
        raise FMUError(f"{file}: the root is '{plain(str(root.tag), 100)}', expected Experiments")
    return [_experiment(e, file) for e in root.findall("Experiment")]


def _experiment(e: Element, file: str) -> UnitExperiment:
    name = plain(e.get("name", ""), 200)
    run = e.find(_TRANSIENT)
    told = e if run is None else run
    kinds = [str(c.tag) for c in e if c.tag not in (_TRANSIENT, "Parameters", "Stimuli", "References", "Annotations")]
    why = [f"a {plain(k, 50)} is no simulation over time" for k in kinds[:1]]
    sources = dict[str, str]()
    for tag, type_ in (("Parameters", SSV), ("Stimuli", CSV), ("References", CSV)):
        part = e.find(tag)
        if part is not None and part.get("type", type_) != type_:
            why.append(f"its {tag} are {plain(part.get('type'), 100)}; this reads {type_}")
        elif part is not None:
            sources[tag] = inside(posixpath.dirname(file), part.get("source", ""))
    where = f"{file}: experiment '{name}'"
    start, stop, step = (_number(told, word, where) for word in ("startTime", "stopTime", "stepSize"))
    parameters, stimuli, results = (sources.get(tag, "") for tag in ("Parameters", "Stimuli", "References"))
    tolerance = _number(e, "tolerance", where)
    return UnitExperiment(name, start, stop, step, tolerance, parameters, stimuli, results, "; ".join(why))


def _number(e: Element, word: str, where: str) -> float | None:
    text = e.get(word)
    try:
        value = None if text is None else float(text)
    except ValueError:
        value = float("nan")
    if value is not None and (not isfinite(value) or (word in ("stepSize", "tolerance") and value <= 0.0)):
        raise FMUError(f"{where}: {word} = '{plain(text or '', 50)}' is no number that it can be")
    return value


def series_text(series: Series) -> bytes:
    """The table as CSV: names, then a row for each time."""
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["time", *series.columns])
    rows = np.column_stack([series.times, *series.columns.values()]) if series.columns else series.times[:, None]
    writer.writerows([number(x) for x in row] for row in rows)
    return out.getvalue().encode()


def read_series(data: bytes, file: str) -> Series:
    """A table whose first column is time and does not go back; entries of arrays, divided by blanks, become scalars.

    FMUError names the line of what is wrong.
    """
    try:
        rows = [r for r in csv.reader(StringIO(data.decode("utf-8-sig"))) if r and not r[0].startswith("#")]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FMUError(f"{file} is not a CSV file in UTF-8: {error}") from None
    head = [n.strip() for n in rows[0]] if rows else []
    if len(rows) < 2 or head[0] != "time":
        raise FMUError(f"{file}: expected a first line that begins with 'time', and a row of values at least")
    if odd := [i for i, r in enumerate(rows, 1) if len(r) != len(head)]:
        raise FMUError(f"{file}, row {odd[0]}: {len(rows[odd[0] - 1])} values, expected {len(head)}")
    times = _column([r[0] for r in rows[1:]])
    if times is None or times.shape[1] != 1 or not np.isfinite(times).all() or (np.diff(times[:, 0]) < 0).any():
        raise FMUError(f"{file}: the column 'time' holds no times in rising order")
    columns, left_out = dict[str, Array](), list[str]()
    for i, name in enumerate(head[1:], 1):
        values = _column([r[i] for r in rows[1:]])
        if values is None:
            left_out.append(plain(name, 100))
        elif values.shape[1] == 1:
            columns[name] = values[:, 0]
        else:
            columns |= {f"{name}[{j}]": values[:, j - 1] for j in range(1, values.shape[1] + 1)}
    return Series(times[:, 0], columns, tuple(left_out))


def _column(texts: Sequence[str]) -> Array | None:
    """(rows, entries), None where these are no numbers, or not as many in each row."""

    def one(text: str) -> Any:
        return _TRUTH[text] if text in _TRUTH else float(text)

    try:
        return np.array([[one(t) for t in text.split()] for text in texts], float).reshape(len(texts), -1)
    except ValueError:
        return None
