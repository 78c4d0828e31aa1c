"""Checkpoints: where a run is between two blocks of steps, and how another process goes on from there to the same bits.

Steps do not depend on how they are cut into blocks, which is a matter of wall time, so that a run that goes on between two blocks
takes the steps of one that was never ended.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol, cast

from phfmu.runs.carried import carried, carry

if TYPE_CHECKING:
    from phfmu.network.couplings.stepper import Stepper


class Checkpoints(Protocol):
    """Keeps what `RunState.now` gives; `found`: what a run that was ended has left, None for one that begins."""

    found: Mapping[str, Any] | None

    def between_blocks(self, now: Callable[[], dict[str, Any]]) -> None:
        """Called between blocks of steps."""
        ...


class RunState:
    """State of a run: all that carries something from block to block, by name, and the number of the stretch under way."""

    def __init__(self, **parts: Any):
        self._parts = parts
        #: number of the stretch, from 0;  what the start left: how it was projected, changes of constraints before it
        self.stretch, self.start = 0, cast("Any", None)

    def now(self) -> dict[str, Any]:
        """The state of all parts, as data that can be written to a file."""
        return {"stretch": self.stretch, "start": self.start, **{n: carried(part) for n, part in self._parts.items()}}

    def take(self, found: Mapping[str, Any], *names: str) -> None:
        """Let the parts of these names go on from the data `found`, in this order."""
        for name in names:
            carry(self._parts[name], found[name])


def require_continued(stepper: Stepper) -> None:
    """Raise ValueError for a stepper whose state cannot be kept in a file, with the units that bar it."""
    if not hasattr(type(stepper), "CARRIED"):
        raise ValueError(f"--checkpoint: the state of {stepper.what} cannot be kept in a file; leave the option out")
    if stepper.unwritten:
        raise ValueError(
            f"--checkpoint: {'; '.join(stepper.unwritten)}; leave the option out, or take units that can save their states and "
            "write them to a file (canGetAndSetFMUState, canSerializeFMUState), as those of phfmu export"
        )
