"""The compiled master under sanitizers: nothing is read or written outside its memory, nothing overflows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phfmu import StepFailure
from tests.sanitized import output


def refused(stepper: Any, t0: float, first: int) -> None:
    """One trial is not enough: the step is refused with all members at its start."""
    stepper.master.rules.iterations = 1
    before = stepper.joined.states()
    with pytest.raises(StepFailure):
        stepper.advance(t0, 1e-3, 2, first)
    assert len(before) == len(stepper.joined.members)


#: members, tangents, ports, and the master
CODE = """
from dataclasses import replace
import numpy as np
from phfmu import Collocated, Coupled, EngineMember, NativeInstance, Options, StepFailure, build_model, run
from tests.network.test_master_sanitized import refused
from phfmu.components.scenes import %s as make
scene = make()
def members(k):
    models = {n: build_model(d, Collocated(k)) for n, d in scene.system.separate().items()}
    return [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
events = [replace(e, t=3e-3) for e in scene.events]
for k in (1, 2):
    stepper = Coupled(scene.system, members(k))
    result = run(stepper, Options(stop=8e-3, step=1e-3, events=events))
    assert stepper.master.taken >= 6, stepper.master.taken
    refused(stepper, 8e-3, 0)
    assert np.isfinite(result.values).all()
    print("steps", result.steps)
"""


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["oscillator", "smib", "speed_control"])
def test_nothing_is_out_of_bounds(tmp_path: Path, scene: str) -> None:
    """Held values and node values, impulses (smib), signals (speed_control), an event, and steps that are refused."""
    assert output(CODE % scene, tmp_path) == ["steps", "8"] * 2


UNITS = """
import sys
from dataclasses import replace
from itertools import cycle
import numpy as np
from phfmu import Collocated, Coupled, EngineMember, FMUInstance, FMUMember, NativeInstance, PythonInstance, build_model, export
from phfmu.components.scenes.electrical.smib import smib
from tests.network.test_master_sanitized import refused
net = smib().system
for k in (1, 2):
    members = []
    for (name, d), kind in zip(net.separate().items(), cycle(["3.0", "2.0", ""])):
        model = build_model(d, Collocated(k))
        if kind:
            kicked = any(p.kind != "none" for p in PythonInstance(model).impulse_ports)
            (path,) = export(model, f"{sys.argv[1]}/{name}{k}", (kind,), step=1e-3, node_inputs=k > 1, impulses=kicked)
            members.append(FMUMember(name, FMUInstance(path, name=name, start=0.0)))
        else:
            members.append(EngineMember(name, model, NativeInstance(model)))
    stepper = Coupled(net, members)
    stepper.check_start()
    stepper.prepare(0.0, 1e-3)
    rows = stepper.advance(0.0, 1e-3, 8)
    assert stepper.master.taken == 8 and np.isfinite(rows.signals).all()
    refused(stepper, 0.0, 8)
    print("steps", len(rows.H))
"""


@pytest.mark.slow
def test_nothing_of_units_is_out_of_bounds(tmp_path: Path) -> None:
    """Held values and node values, impulses, both versions and a native member, and steps that are refused."""
    code = UNITS.replace("sys.argv[1]", repr(str(tmp_path)))
    assert output(code, tmp_path) == ["steps", "8"] * 2


COUPLINGS = """
from dataclasses import replace
import numpy as np
from phfmu import Anderson, Coupled, EngineMember, GaussSeidel, Jacobi, NativeInstance, build_model
from tests.network.test_compiled_couplings import resistive
from tests.network.test_compiled_signals import servo
from tests.network.test_master_sanitized import refused
for net in (resistive(), servo()):
    for make in (Anderson, GaussSeidel, Jacobi):
        models = {n: build_model(replace(d, name=n)) for n, d in net.declared.items()}
        members = [EngineMember(n, m, NativeInstance(m)) for n, m in models.items()]
        stepper = Coupled(net, members, make(), threads=2)
        stepper.check_start()
        stepper.prepare(0.0, 1e-3)
        rows = stepper.advance(0.0, 1e-3, 8)
        assert stepper.master.taken == 8 and np.isfinite(rows.signals).all()
        if stepper.coupling.repeats:
            refused(stepper, 0.0, 8)
        print("steps", len(rows.H))
"""


@pytest.mark.slow
def test_nothing_of_other_couplings_is_out_of_bounds(tmp_path: Path) -> None:
    """What iterates and what steps once, feedthrough, held signals, two threads, and steps that are refused."""
    assert output(COUPLINGS, tmp_path) == ["steps", "8"] * 6
