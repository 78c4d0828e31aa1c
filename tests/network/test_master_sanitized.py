"""The compiled master under sanitizers: nothing is read or written outside its memory, nothing overflows."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.sanitized import output

#: members, tangents, ports, and the master
CODE = """
from dataclasses import replace
import numpy as np
from phfmu import Collocated, Coupled, EngineMember, NativeInstance, Options, StepFailure, build_model, run
from phfmu.components.scenes.%s import %s as make
scene = make()
def members(k):
    models = {n: build_model(d, Collocated(k)) for n, d in scene.system.separate().items()}
    return [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
events = [replace(e, t=3e-3) for e in scene.events]
for k in (1, 2):
    stepper = Coupled(scene.system, members(k))
    result = run(stepper, Options(stop=8e-3, step=1e-3, events=events))
    assert stepper._master.taken >= 6, stepper._master.taken
    stepper._master.rules.iterations = 1
    stepper.advance(8e-3, 1e-3, 2)
    assert np.isfinite(result.values).all()
    print("steps", result.steps)
"""


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["oscillator", "smib", "speed_control"])
def test_nothing_is_out_of_bounds(tmp_path: Path, scene: str) -> None:
    """Held values and node values, impulses (smib), signals (speed_control), an event, and steps that are left to Python."""
    assert output(CODE % (scene, scene), tmp_path) == ["steps", "8"] * 2
