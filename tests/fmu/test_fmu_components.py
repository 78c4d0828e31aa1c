"""Every component and scene of the library as FMU 2.0 and 3.0: valid, and equal to the native engine for 1000 steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from phfmu import FMUInstance, NativeInstance, Scene, build_model, export
from phfmu.components.library import LIBRARY, SWITCHED, build
from phfmu.network.members.columns import SignalColumns
from tests.wide import turning

STEPS = 250
#: scenes bring their own step; components take one at which they move
STEP = {"four_particle": 0.01, "mass": 0.01, "mass_spring": 0.01, "spring": 0.01, "damper": 0.01}


def two_tone(model, h: float, n: int) -> np.ndarray:
    """Inputs n x nu around their start values: two tones a port entry, no two alike."""
    t = h * np.arange(n)[:, None]
    j = np.arange(model.step.nu)[None, :]
    size = 0.05 * np.maximum(np.abs(model.u0), 1.0)
    span = n * h
    return model.u0 + size * (
        np.sin(2 * np.pi * (3 + j) * t / span) + 0.5 * np.cos(2 * np.pi * (17 + 2 * j) * t / span)
    )


@pytest.mark.parametrize(("name", "version"), turning([n for n in LIBRARY if n not in SWITCHED], ["2.0", "3.0"]))
def test_units_equal_the_native_engine(name: str, version: str, tmp_path: Path) -> None:
    found = build(name)
    declaration = found.declaration() if isinstance(found, Scene) else found
    h = found.step if isinstance(found, Scene) else STEP.get(name, 1e-4)
    model = build_model(declaration)
    native = NativeInstance(model)
    columns = SignalColumns(model, native.layout)
    shown = [f"mode.{n}" if n in declaration.modes else n for n in columns.names]
    u = two_tone(model, h, STEPS)
    expected = np.zeros((STEPS, len(columns.names)))
    for k in range(STEPS):
        if model.step.nu:
            native.set_input(u[k])
        native.do_step(k * h, h)
        expected[k] = columns.now(native)
    (path,) = export(model, tmp_path, (version,), step=h)
    assert validate_fmu(str(path)) == []
    with FMUInstance(path) as unit:
        seen = np.zeros_like(expected)
        for k in range(STEPS):
            if model.step.nu:
                unit.set_input(u[k])
            unit.do_step(k * h, h)
            seen[k] = unit.get(shown)
    scale = np.max(np.abs(expected), axis=0)
    # sums that cancel (a lossless system's supply, residuals) are rounding of the energies they are made of
    energies = np.array([".energy" in f".{n}" for n in columns.names])
    scale[energies] = max(scale[energies].max(), 1e-300)
    constraints = np.array([n.startswith("constraint.") for n in columns.names])
    scale[constraints] = np.maximum(scale[constraints], 1.0)
    worst = np.max(np.abs(seen - expected) / np.where(scale > 0, scale, 1.0), axis=0)
    assert np.max(worst, initial=0.0) <= 1e-11, columns.names[int(np.argmax(worst))]
