"""States that are kept inside a unit, each freed when nobody holds it any more."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import Any

from phfmu.fmu.archive import Archive
from phfmu.fmu.slave import AnySlave


@dataclass(eq=False)
class SavedState:
    """A state inside the unit and what the instance knows beside it, its time among that; freed when nobody holds it."""

    handle: Any
    memory: dict[str, Any]


class SavedStates:
    """Those of one unit; the unit is freed after them."""

    def __init__(self, slave: AnySlave):
        self._slave, self._handles = slave, dict[int, tuple[Any, float]]()

    def keep(self, handle: Any, memory: dict[str, Any]) -> SavedState:
        state = SavedState(handle, memory)
        self._handles[id(handle)] = handle, memory["time"]
        weakref.finalize(state, self._forget, id(handle))
        return state

    def reach_before(self, t: float) -> bool:
        """Whether one is held that belongs to a time before t, so that it may be restored."""
        return bool(self._handles) and any(time < t for _, time in self._handles.values())

    def _forget(self, key: int) -> None:
        kept = self._handles.pop(key, None)
        if kept is not None:
            self._slave.forget(kept[0])

    def free(self) -> None:
        """All of them, then the unit."""
        for key in list(self._handles):
            self._forget(key)
        self._slave.free()


def free(states: SavedStates, archive: Archive) -> None:
    """The unit with its states; `archive` is held so that its folder outlives the library."""
    del archive
    states.free()
