"""Tables of changes of modes, as ctypes structures or as C text; see runtime/modes/modes.h."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

from phfmu.engine.build.derived import group_values
from phfmu.engine.build.tables import TableMemory, array_of_structs, ctypes_structures, struct_text
from phfmu.events.switch_tables import ModeRows, SwitchTables
from phfmu.plan.plan import Kernel


def mode_groups(tables: SwitchTables, index: Callable[[Kernel], int]) -> list[tuple[Any, dict[str, Any]]]:
    """Groups of the equations: rates, gradients."""
    return [(g, group_values(g, 0, index)) for g in tables.groups]


class ModeTables(TableMemory):
    """The switches of a model; `pointer` is valid as long as this object lives."""

    def __init__(self, tables: SwitchTables, index: Callable[[Kernel], int], code: int) -> None:
        super().__init__()
        at, size = self.groups(mode_groups(tables, index)), ctypes.sizeof(ctypes_structures()["ph_group"])
        self.pointer = ctypes.addressof(
            self.fill("ph_switches", tables, {"code": code, "rates": at, "energy": at + size})
        )

    def rows(self, rows: ModeRows) -> int:
        """Address of the `ph_mode_rows` of a mode."""
        return ctypes.addressof(self.fill("ph_mode_rows", rows, {}))


def switches_text(tables: SwitchTables, index: Callable[[Kernel], int], symbol: str) -> str:
    """C source that defines `const ph_switches <symbol>`."""
    groups = array_of_structs("ph_group", "switch_groups", mode_groups(tables, index))
    arrays, members = struct_text(
        "ph_switches",
        "switches",
        tables,
        {"code": "&ph_the_code", "rates": "switch_groups", "energy": "switch_groups + 1"},
    )
    return (
        f'#include <math.h>\n\n#include "modes.h"\n\n{groups}{arrays}'
        f"extern const ph_switches {symbol};\nconst ph_switches {symbol} = {members};\n"
    )


def rows_text(rows: Sequence[ModeRows], symbol: str) -> str:
    """C source that defines `const ph_mode_rows <symbol>[]`."""
    text = array_of_structs("ph_mode_rows", "mode_rows", [(r, {}) for r in rows])
    head = "static const ph_mode_rows mode_rows[] ="
    return text.replace(head, f"extern const ph_mode_rows {symbol}[];\nconst ph_mode_rows {symbol}[] =")
