"""Recordings: signals over time and marks that a run leaves to draw."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Signal:
    """Values [n] over times [n] in seconds; `unit` None: the file does not say.

    `topic`: signals of one topic share an axis; without one those of a unit do. `log`: drawn as magnitude on a log axis.
    `kind`: what it is (`phfmu.signals.SignalKind`), "" where nothing tells.
    `label`: what readers call it, "" for its name.
    `limit`: the limit of another signal. `points`: drawn as points.
    `owner` counts what signals belong to, for colours that are the same on all axes.
    """

    name: str
    unit: str | None
    time: Floats
    values: Floats
    topic: str = ""
    log: bool = False
    limit: bool = False
    owner: int | None = None
    kind: str = ""
    label: str = ""
    points: bool = False


@dataclass(frozen=True)
class Mark:
    """Something that happened at a time."""

    time: float
    text: str


def together(marks: Iterable[Mark]) -> list[Mark]:
    """Marks in order of time, those of one time as one."""
    texts: dict[float, list[str]] = {}
    for m in marks:
        texts.setdefault(m.time, []).append(m.text)
    return [Mark(t, ", ".join(dict.fromkeys(texts[t]))) for t in sorted(texts)]


class Recording(Protocol):
    """A source of signals; `names` in the order of the file."""

    @property
    def title(self) -> str: ...

    @property
    def names(self) -> Sequence[str]: ...
    @property
    def kinds(self) -> Mapping[str, str]:
        """The kinds of signals that are told to be something."""
        ...

    @property
    def labelled(self) -> Mapping[str, str]:
        """Readers' names of signals -> their names, where the two differ."""
        ...

    def usual(self) -> list[str]:
        """Names that are drawn when none are asked for."""
        ...

    def read(self, names: Sequence[str]) -> list[Signal]: ...

    def marks(self) -> list[Mark]: ...
