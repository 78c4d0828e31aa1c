"""Models in compiled code: the library and the tables of each, made once for all its instances."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

from phfmu.engine.build.codegen import kernel_table
from phfmu.engine.build.compile import Build
from phfmu.engine.build.tables import CTables
from phfmu.engine.model import Model, first, kernels
from phfmu.engine.native.library import build, load


@dataclass(frozen=True)
class Compiled:
    """What instances share and never write to."""

    build: Build
    tables: CTables
    lib: ctypes.CDLL


_MADE: WeakKeyDictionary[Model, Compiled] = WeakKeyDictionary()


def compiled(model: Model, announce: Callable[[], None] | None = None) -> Compiled:
    """Library and tables of a model; `announce` is called before a compiler runs."""
    made, alike = _MADE.get(model), first(model)
    if made is None and alike is not None:
        shared = compiled(alike, announce)
        made = _MADE[model] = replace(shared, tables=shared.tables.like(model))
    elif made is None:
        table = kernel_table(kernels(model), model.step.schur)
        tables = CTables(model, table.index, table.token)
        done = build(table, announce, events=tables.events is not None)
        made = _MADE[model] = Compiled(done, tables, load(done.path))
    return made
