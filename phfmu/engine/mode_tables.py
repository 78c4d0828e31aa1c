"""Tables of changes of modes, as ctypes structures; see runtime/modes/modes.h."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from phfmu.engine.derived import group_values
from phfmu.engine.tables import Filled, ctypes_structures
from phfmu.events.switch_tables import ModeRows, SwitchTables
from phfmu.plan.plan import Kernel


def mode_groups(tables: SwitchTables, index: Callable[[Kernel], int]) -> list[tuple[Any, dict[str, Any]]]:
    """Groups of the equations: rates, gradients."""
    return [(g, group_values(g, 0, index)) for g in tables.groups]


class ModeTables(Filled):
    """The switches of a model; `pointer` is valid as long as this object lives."""

    def __init__(self, tables: SwitchTables, index: Callable[[Kernel], int]) -> None:
        super().__init__()
        at, size = self.groups(mode_groups(tables, index)), ctypes.sizeof(ctypes_structures()["ph_group"])
        self.pointer = ctypes.addressof(self.fill("ph_switches", tables, {"rates": at, "energy": at + size}))

    def rows(self, rows: ModeRows) -> int:
        """Address of what is known of a mode."""
        return ctypes.addressof(self.fill("ph_mode_rows", rows, {}))
