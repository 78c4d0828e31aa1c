"""Steps of a model with switches in compiled code; modes change in Python, between its calls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from phfmu.engine.landing import Landing
from phfmu.engine.record import Grid
from phfmu.events.happened import Landed


def landed_natively(switched: Any, grid: Grid, names: tuple[str, ...], changed: bool) -> Iterator[Landed]:
    """`land` of a `SwitchedInstance` of native instances: to the next change of a mode without leaving C."""
    landing = Landing(switched.present, switched)
    landing.begin()
    if changed and switched.unsettled:
        settled = landing.happen(grid.start(0), grid.h, [], 0)
        if settled.switched:
            yield Landed.of([], settled)
    native, check = _landing(switched)
    parts = native.over(grid, names, changed, check)
    while True:
        for part in parts:
            yield _trimmed(switched, part)
        stopped = native.stopped()
        if not stopped:
            return
        t, fired, events = stopped
        yield Landed.of([], landing.happen(t, grid.h, fired, events))
        before, (native, check) = native, _landing(switched)
        native.after(before, check)
        parts = native.on(grid.n, names, check)


def _landing(switched: Any) -> Any:
    """That of the present mode, which stops before events that set modes of switches."""
    native, check = switched.present.landing
    native.stop_before(switched.changes)
    return native, check


def _trimmed(switched: Any, part: Landed) -> Landed:
    """With the signals of the model, not of the mode."""
    rows = {name: switched.trimmed(r) if name == "signals" else np.asarray(r) for name, r in part.rows.items()}
    found = part.happened and replace(part.happened, signals=switched.trimmed(part.happened.signals))
    return replace(part, rows=rows, happened=found)
