"""Records of accepted steps, from the engines to the result table and the audit, and the balance of their energies.

Stretches of steps between state events have the same form.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Energy = TypeVar("Energy", float, NDArray[np.float64])


def balance(stored: Energy, dissipated: Energy, supplied: Energy, numerical: Energy | float = 0.0) -> Energy:
    """The gap of a ledger: stored + dissipated + numerical - supplied [J], zero to rounding.

    `numerical`: lost by a damping scheme.  Power is positive into the component; floats, or arrays of one shape.
    """
    return stored + dissipated + numerical - supplied


@dataclass(frozen=True)
class StepEvent:
    """An event at time t within a step that is told as one.

    energy, lost (c): by component, what it added to H and what was lost [J];  names: of the guards;  message: with what they
    set;  kind: as the audit calls it
    """

    t: float
    energy: Array
    lost: Array
    names: str
    message: str
    kind: str = "state"


@dataclass(frozen=True)
class Steps:
    """n accepted steps of c components with q scalar port pairs; energies in joule, positive into the component."""

    #: stored energy at the end of each step (n x c)
    H: Array
    #: change of it, dissipated and supplied energy (n x c)
    stored: Array
    dissipated: Array
    supplied: Array
    #: energy through each pair (n x q)
    pairs: Array
    #: lost by a damping scheme (n x c), None where there is none
    numerical: Array | None = None
    #: sum over the energies of a component of |change| (n x c), None where only their sum is known
    moved: Array | None = None
    #: of Newton's method, or of that of the coupling (n), None where a unit does not tell
    iterations: Array | None = None
    #: by which test a coupling took the step (n names), None without one
    accepted_by: Array | None = None
    #: longer trials from the start of each step that were taken back (n), None where steps are not taken again
    rejected: Array | None = None
    #: what a coupling did at its junctions, part by part (n x parts), None where its junctions have no parts
    works: Array | None = None
    #: energy through each pair by the values that were exchanged (n x q), None where no member could book another
    exchanged: Array | None = None
    #: what each energy stored and each part of R dissipated (n x terms), None unless asked for
    terms: Array | None = None
    #: columns of the result table at the ends (n x names), empty where there is no table
    signals: Array = field(default_factory=lambda: np.zeros((0, 0)))
    #: rows of it within each step (n x rows x names), None unless asked for
    between: Array | None = None
    #: unknowns of each step's solve (n x nw), None unless asked for
    unknowns: Array | None = None
    #: number of a step, and what happened within it, in order
    events: tuple[tuple[int, StepEvent], ...] = ()

    @property
    def spent(self) -> float:
        """Iterations of all steps, 0 where a unit does not tell."""
        return 0.0 if self.iterations is None else float(self.iterations.sum())

    @classmethod
    def recorded(cls, record: Mapping[str, Array], signals: Array) -> Steps:
        """The steps that `run` of an instance recorded of `LEDGER`; `signals`: the columns that are wanted."""
        return cls(
            record["energy"], record["stored"], record["dissipated"], record["supplied"], record["pairs"],
            record.get("numerical"), record["moved"], record["counts"][:, 0], signals=signals,
        )  # fmt: skip

    @classmethod
    def stacked(cls, rows: Sequence[Mapping[str, Any]]) -> Steps:
        """From the values of each step by field; a field that a step lacks is None."""
        names = [n for n in _ARRAYS if all(n in row for row in rows)]
        events = tuple((i, e) for i, row in enumerate(rows) for e in row.get("events", ()))
        return cls(**{name: np.array([row[name] for row in rows]) for name in names}, events=events)

    @classmethod
    def joined(cls, parts: Sequence[Steps]) -> Steps:
        """The steps of parts, one after the other.

        A part without numerical loss has 0 where others have one; other fields are kept where all parts have them.
        """
        columns = {name: [getattr(p, name) for p in parts] for name in _ARRAYS}
        if any(lost is not None for lost in columns["numerical"]):
            columns["numerical"] = [np.zeros_like(p.H) if p.numerical is None else p.numerical for p in parts]
        whole = {name: found for name, found in columns.items() if all(part is not None for part in found)}
        first = np.cumsum([0, *(len(p.H) for p in parts)]).tolist()
        events = tuple((k + i, e) for k, p in zip(first, parts, strict=False) for i, e in p.events)
        return cls(**{name: np.concatenate(found) for name, found in whole.items()}, events=events)

    def part(self, begin: int, end: int) -> Steps:
        """Steps begin..end-1, without what happened in them."""
        found = {n: values[begin:end] for n in _ARRAYS if (values := getattr(self, n)) is not None}
        return Steps(**found)


#: fields that have a row for each step
_ARRAYS = tuple(f.name for f in fields(Steps) if f.name != "events")

#: what `Steps.recorded` needs of a run; `numerical` too where the scheme loses energy
LEDGER = ("signals", "energy", "stored", "dissipated", "supplied", "moved", "pairs", "counts")


@dataclass(frozen=True)
class EventRecord:
    """State events at one instant: numbers of the `events`, and of the `rests` among them that came to rest.

    energy, lost:  by component, what the jump added to its H and what it lost (J); the sums of both are 0 together
    signals:  the table row after it;  switched: switches that changed with it, in words
    """

    t: float
    events: tuple[int, ...]
    rests: tuple[int, ...]
    energy: Array
    lost: Array
    signals: Array
    switched: tuple[str, ...] = ()


@dataclass(frozen=True)
class Landed:
    """Accepted steps with their starts t (n), sizes h (n) and recorded rows; `happened` at the end of the last one.

    No steps where one event follows another at once.
    """

    t: Array
    h: Array
    rows: dict[str, Array]
    happened: EventRecord | None
