"""The compiled master under sanitizers: nothing is read or written outside its memory, nothing overflows."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SANITIZE = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
#: everything in C is compiled with them: members, tangents, ports, and the master
CODE = """
import importlib.util
from dataclasses import replace
import numpy as np
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "ziglang" else find(name, *more)
from phfmu.engine import compile as c
c.FLAGS = (*(f for f in c.FLAGS if f != "-O2"), "-O1", "-g", *%r)
c.LINK = ("-shared", *%r)
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


@pytest.fixture(scope="module")
def preloaded() -> dict[str, str]:
    """Environment with the run-time of gcc's sanitizers; else the test is skipped with the reason."""
    gcc = shutil.which("gcc")
    if gcc is None or not sys.platform.startswith("linux"):
        pytest.skip("needs gcc on Linux")
    found = []
    for name in ("libasan.so", "libubsan.so"):
        path = subprocess.run([gcc, f"-print-file-name={name}"], capture_output=True, text=True).stdout.strip()
        if not Path(path).is_file():
            pytest.skip(f"gcc has no {name}")
        found.append(path)
    environment = os.environ | {"LD_PRELOAD": " ".join(found), "ASAN_OPTIONS": "detect_leaks=0"}
    if subprocess.run([sys.executable, "-c", "import numpy, casadi"], env=environment, capture_output=True).returncode:
        pytest.skip("this Python does not run under the address sanitizer")
    return environment


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["oscillator", "smib", "speed_control"])
def test_nothing_is_out_of_bounds(preloaded: dict[str, str], tmp_path: Path, scene: str) -> None:
    """Held values and node values, impulses (smib), signals (speed_control), an event, and steps that are left to Python."""
    code = CODE % (SANITIZE, SANITIZE, scene, scene)
    environment = preloaded | {"PHFMU_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stderr[-4000:]
    assert done.stdout.split() == ["steps", "8"] * 2
