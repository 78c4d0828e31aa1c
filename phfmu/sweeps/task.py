"""The common part of all runs of a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from phfmu.discretise.model import Model
from phfmu.runs.options import Options
from phfmu.sweeps.measures import Measure


@dataclass(frozen=True)
class Task:
    """Runs of `model` that differ in the values of `names` and are told by `measures`."""

    model: Model
    names: tuple[str, ...]
    measures: Sequence[Measure]
    options: Options
