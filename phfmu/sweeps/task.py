"""The common part of all runs of a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from phfmu.discretise.model import Model
from phfmu.runs.options import Options
from phfmu.sweeps.measures import Measure


@dataclass(frozen=True)
class Task:
    """Runs that differ in the values of `names` and are told by `measures`; `words`: all that outcomes depend on besides."""

    names: tuple[str, ...]
    measures: Sequence[Measure]
    words: tuple[str, ...]


@dataclass(frozen=True)
class ModelTask(Task):
    """Runs of one composed model."""

    model: Model
    options: Options
