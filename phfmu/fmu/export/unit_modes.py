"""Ideal switches of a unit: the models of all its modes, and what is generated of them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from weakref import WeakKeyDictionary

from phfmu.declare.error import DeclarationError
from phfmu.discretise.model import Model
from phfmu.engine.build.codegen import KernelTable
from phfmu.engine.build.mode_tables import rows_text, switches_text
from phfmu.engine.build.tables import c_text, events_text
from phfmu.engine.model import kernels
from phfmu.events.modes import Mode
from phfmu.events.switch_tables import ModeRows, SwitchTables, mode_rows, switch_tables
from phfmu.fmu.export.variables import FMUError
from phfmu.plan.plan import Kernel, Plan

#: modes that a unit may have
MOST_MODES = 64
#: names of the tables in C
SWITCHES, ROWS = "ph_the_switches", "ph_the_mode_rows"


@dataclass(frozen=True, eq=False)
class UnitModes:
    """The models of the modes, the first one that of the start, and their `rows`; `names`: of the switches."""

    rows: tuple[ModeRows, ...]
    models: tuple[Model, ...]
    tables: SwitchTables
    names: tuple[str, ...]

    @property
    def kernels(self) -> list[Kernel]:
        return [*(k for m in self.models for k in kernels(m)), *self.tables.kernels]

    @property
    def plans(self) -> list[Plan]:
        """Steps of the modes besides that of the start."""
        return [m.step for m in self.models[1:]]

    def texts(self, table: KernelTable, tangents: str) -> dict[str, str]:
        """C files of the modes besides that of the start, and of the switches."""
        files = {"switches.c": switches_text(self.tables, table.index, SWITCHES)}
        files["switches.c"] += rows_text(self.rows, ROWS)
        for i, m in enumerate(self.models):
            if i == 0:
                continue
            assert m.events is not None
            files[f"mode{i}.c"] = c_text(m, table.index, model_symbol(i), tangents)
            files[f"guards{i}.c"] = events_text(m.events, table.index, events_symbol(i))
        return files


def model_symbol(i: int) -> str:
    """Name of the model of mode i."""
    return f"ph_mode{i}" if i else "ph_the_model"


def events_symbol(i: int) -> str:
    """Name of its state events."""
    return f"ph_events{i}" if i else "ph_the_events"


def symbols(files: Iterable[str]) -> Iterator[str]:
    """The symbols of the files of modes that the linker sees."""
    for name in files:
        found = re.fullmatch(r"(mode|guards)(\d+)\.c", name)
        if found:
            yield model_symbol(int(found[2])) if found[1] == "mode" else events_symbol(int(found[2]))
        elif name == "switches.c":
            yield from (SWITCHES, ROWS)


_MADE: WeakKeyDictionary[Model, UnitModes] = WeakKeyDictionary()


def unit_modes(model: Model) -> UnitModes | None:
    """All modes of a model with switches; None for others.  FMUError if there are too many."""
    if model.modes is None or model.events is None:
        return None
    if model not in _MADE:
        modes = model.modes.modes
        if 2 ** len(modes.switches) > MOST_MODES:
            raise FMUError(
                f"{model.name}: has {len(modes.switches)} ideal switches, {2 ** len(modes.switches)} modes; a unit has at most "
                f"{MOST_MODES}. Export parts of it, or run it with --engine native or python"
            )
        sides = product((0, 1), repeat=len(modes.switches))
        found = {
            m: built for m in sorted(sides, key=lambda m: m != modes.start) if (built := _built(model, m)) is not None
        }
        tables = switch_tables(modes, model.step, model.events, len(model.observable_names))
        _MADE[model] = UnitModes(
            tuple(mode_rows(modes, m) for m in found),
            tuple(found.values()),
            tables,
            tuple(s.name for s in modes.switches),
        )
    return _MADE[model]


def _built(model: Model, mode: Mode) -> Model | None:
    """The model of a mode; None if its equations have no solution, so that it never comes up."""
    assert model.modes is not None
    try:
        return model.modes[mode]
    except DeclarationError:
        return None
