"""What the run loop drives, whether one composed model, one unit or coupled members."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.network.members.booking import Booking

if TYPE_CHECKING:
    from phfmu.discretise.start import Projection
    from phfmu.engine.rest_changes import RestChange

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Steps:
    """n accepted steps: columns of `signals` as the stepper's `names`; ledger per component and scalar port pair."""

    signals: Array
    H: Array
    stored: Array
    dissipated: Array
    supplied: Array
    pairs: Array
    iterations: Array
    #: lost by a damping scheme (n x components), None where there is none
    numerical: Array | None = None
    #: sum over the energies of a component of |change| (n x components), None where only their sum is known
    moved: Array | None = None
    #: rows within each step (n x rows x names), None unless asked for
    between: Array | None = None

    @classmethod
    def stacked(cls, rows: Sequence[Mapping[str, Any]]) -> Steps:
        """From the values of each step by field; a field that a step lacks is None."""
        names = [f.name for f in fields(cls) if all(f.name in row for row in rows)]
        return cls(**{name: np.array([row[name] for row in rows]) for name in names})

    @classmethod
    def joined(cls, parts: list[Steps]) -> Steps:
        """One after the other; a part without numerical loss has 0 where others have one."""
        names = ("signals", "H", "stored", "dissipated", "supplied", "pairs", "iterations")
        arrays = {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}
        moved = [p.moved for p in parts if p.moved is not None]
        lossy = any(p.numerical is not None for p in parts)
        lost = [np.zeros_like(p.H) if p.numerical is None else p.numerical for p in parts]
        between = (
            None if parts[0].between is None else np.concatenate([p.between for p in parts if p.between is not None])
        )
        return cls(
            **arrays, numerical=np.concatenate(lost) if lossy else None,
            moved=np.concatenate(moved) if len(moved) == len(parts) else None, between=between,
        )  # fmt: skip


class Stepper(Protocol):
    """Drives a system through n steps, numbers first..first+n-1 of the grid t0 + k h.

    When a step fails, the state is that of the last accepted one and StepFailure.recorded["steps"] holds those before.
    """

    names: list[str]
    booking: Booking
    #: what it is, and how to get one composed model instead; for messages
    what: str
    instead: str

    def settable(self) -> list[str]: ...
    def set_value(self, name: str, value: float) -> str: ...
    def read(self) -> Array: ...
    def energies(self) -> Array: ...
    def rest_changes(self) -> dict[str, list[RestChange]]:
        """Member ("" for a whole system) -> the last changes of its constraints at rest."""
        ...

    def check_start(self) -> None: ...
    def project_start(self, t0: float, kept: Sequence[str] = ()) -> Projection | None: ...
    def prepare(self, t0: float, h: float) -> None:
        """Once before the first step, of size h: what `read` shows of a step is of a trial step that is taken back."""
        ...

    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps: ...
