"""When the iteration of a step of coupled members is accepted: the twin of `runtime/acceptance.c`, which has the numbers too.

    energy:          energy left within budget, and every row at rounding
    rounding floor:  rows that stopped shrinking within it, or rows that a relative change of the unknowns by eps explains

Rows of stiff members that hardly act stop at what such a change makes of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from phfmu.outcome.limits import defined

RULES = Path(__file__).parent / "runtime" / "acceptance.h"
_NUMBERS = defined(RULES)

ITERATIONS = int(_NUMBERS["COUPLED_ITERATIONS"])
ENERGY, ROUNDING, STAGNATION = (_NUMBERS[f"COUPLED_{n}"] for n in ("ENERGY", "ROUNDING", "STAGNATION"))
SHRINKING, STALLING, STALLED = (_NUMBERS[f"COUPLED_{n}"] for n in ("SHRINKING", "STALLING", "STALLED"))
STALLS, FLOOR, END = (_NUMBERS[f"COUPLED_{n}"] for n in ("STALLS", "FLOOR", "END"))
#: steps that tell what the continuation of the last one will miss
KNOWN = int(_NUMBERS["COUPLED_KNOWN"])

BY_ENERGY, BY_FLOOR = "energy", "rounding floor"
#: of steps that did not converge and were kept, or taken in parts
KEPT, HALVED = "unconverged", "halved"


@dataclass
class Progress:
    """How an iteration went so far; `held`: by the rules for one held value per unknown.

    history: largest scaled residual of each trial;  matrices: how many were taken
    """

    held: bool
    history: list[float] = field(default_factory=list)
    stalled: bool = False
    stalls: int = 0
    matrices: int = 0

    def note(self, scaled: float) -> None:
        """One more trial with its largest scaled residual."""
        if len(self.history) > 1:
            before = self.history[-1]
            self.stalled = scaled > SHRINKING * before
            self.stalls += scaled > (STALLING if self.held else SHRINKING) * before
        self.history.append(scaled)

    @property
    def decides(self) -> bool:
        """Whether it depends on the energy in play if the last trial is accepted, or needs a matrix."""
        return self.stalled or self.stalls >= STALLS or self.history[-1] <= ROUNDING

    def accepted(self, floor: Callable[[], bool], left: float, in_play: float) -> str:
        """By which test, "" if by none.  floor: whether all rows are rounding;  left, in_play: energies [J]."""
        if self.stalled and self.matrices and floor():
            return BY_FLOOR
        within = left <= ENERGY * in_play
        if not within and not (self.held and self.stalled and left <= STALLED * ENERGY * in_play):
            return ""
        if self.history[-1] <= ROUNDING:
            return BY_ENERGY
        if self.held and self.stalled and self.history[-1] <= STAGNATION:
            return BY_FLOOR
        return BY_FLOOR if self.stalls >= STALLS and within and (self.held or self.matrices > 1) else ""

    def takes_matrix(self, left: float, in_play: float) -> bool:
        """Whether what was not accepted needs a matrix of its last trial."""
        if self.held or not self.matrices:
            return True
        return self.stalled and (self.matrices < 2 or not left <= ENERGY * in_play)
