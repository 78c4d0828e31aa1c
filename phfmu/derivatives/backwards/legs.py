"""A run that is kept to go back over: stretches of steps (`Leg`), and the calls of compiled code that made them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.event_maps import EventInstant
from phfmu.engine.record import Grid
from phfmu.events.modes import Mode

Array = NDArray[np.float64]


@dataclass
class TapeSegment:
    """Parts of steps (rows of a tape), and the algebraic variables at the ends of the steps (n x na) if they were asked for."""

    rows: Array
    a_end: Array | None

    @property
    def size(self) -> int:
        """Bytes."""
        return self.rows.nbytes + (0 if self.a_end is None else self.a_end.nbytes)


@dataclass(frozen=True)
class Occurrence:
    """State events at the end of a leg: numbers of those that happened and of those that came to rest; parameters, states and
    algebraic variables after them.  `end`: algebraic variables before them."""

    t: float
    fired: tuple[int, ...]
    rests: tuple[int, ...]
    after: EventInstant
    a_before: Array
    entered: Mode | None


@dataclass
class Leg:
    """n steps: starts and lengths (n), how they were taken, rows `first_row`.. of the run, states at the end, what was set after
    them.  `occurrence`: what happened at its end;  `moves`: its start is the instant of an event, and follows from values;
    mode: of ideal switches;  damped: the companion that took it, None where the instance did."""

    starts: Array
    sizes: Array
    inputs: Array | None
    held: Array
    parameters: Array
    first_row: int
    call: CompiledCall
    end: Array = field(default_factory=lambda: np.zeros(0))
    kept: TapeSegment | None = None
    cuts: list[str] = field(default_factory=list)
    occurrence: Occurrence | None = None
    moves: bool = False
    mode: Mode | None = None
    damped: Any = None

    @property
    def n(self) -> int:
        return len(self.starts)

    @property
    def entered(self) -> Mode | None:
        """The mode after it."""
        return self.mode if self.occurrence is None else self.occurrence.entered

    @property
    def rows(self) -> int:
        """Rows of the run that it has."""
        return self.n + (self.occurrence is not None)

    def input_at_end(self, i: int, last: Array) -> Array:
        """Inputs at the end of its i-th step; `last`: weights of the nodes there."""
        if self.inputs is None:
            return self.held
        own = self.inputs[i]
        return last @ own if own.ndim == 2 else own


@dataclass
class CompiledCall:
    """A call of compiled code for the steps of a grid: the state before it, what it was given, the legs that it made.

    changed: None for steps without events, else whether something was set before them
    """

    state: Any
    grid: Grid
    inputs: Array | None
    changed: bool | None
    legs: list[Leg] = field(default_factory=list)

    @property
    def kept(self) -> int:
        """Bytes of its tapes."""
        return sum(leg.kept.size for leg in self.legs if leg.kept is not None)
