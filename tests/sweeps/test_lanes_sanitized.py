"""Runs side by side in C under sanitizers: nothing is read or written outside its memory, nothing overflows."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.sanitized import output

CODE = """
import numpy as np
from phfmu import Options
from phfmu.components.library import build
from phfmu.schemes.named import named_scheme
from phfmu.sweeps import lanes, native_runs
from phfmu.sweeps.native_runs import NativeRuns
from phfmu.sweeps.recipe import Recipe

native_runs.PAYS, lanes.EARNS, lanes.NODES = 0, 0, 3

def same(name, varied, values, order, stop, step):
    target = build(name)
    d = target if not hasattr(target, "declaration") else target.declaration()
    options, scheme = Options(stop=stop, step=step), named_scheme(d, order=order)
    task = Recipe(target, (varied,), ("last(energy.stored)",), options, scheme, "native").task()
    rows = np.array(values, float)[:, None]
    alone, together = NativeRuns(task, lanes=False).take(rows), NativeRuns(task).take(rows)
    assert together.inside > 0 and alone.values.tobytes() == together.values.tobytes()
    print(f"{name}{order}")

same("oscillator", "mass1.k", np.linspace(20.0, 40.0, 8), 2, 0.1, 0.01)
for order in (2, 6):
    # errors in two runs, stiff springs in all, and rows nearly dependent
    same("four_particle", "eta0", [0.1, 0.2, -20.0, 0.3, 0.4, 0.5, -10.0, 0.7], order, 1.0, 0.01)
    same("four_particle", "k13", np.geomspace(5e6, 5e7, 9), order, 0.2, 0.02)
    same("four_bar", "m[1]", np.linspace(0.8, 1.3, 8), order, 0.6, 0.01)
same("heavy_top", "m[1]", np.linspace(0.9, 1.1, 8), 2, 0.1, 0.01)
"""


@pytest.mark.long
def test_runs_side_by_side_stay_inside_their_memory(tmp_path: Path) -> None:
    orders = ["four_particle", "four_particle", "four_bar"]
    assert output(CODE, tmp_path) == ["oscillator2", *(f"{n}{o}" for o in (2, 6) for n in orders), "heavy_top2"]
