"""Importers of other projects, ecos and libcosim: scripts for a process of their own, because they are C++ libraries."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.util import find_spec

import pytest

#: how scripts begin; `task` is what the test gives
_ECOS = """
import ctypes, json, sys
from importlib.metadata import PackageNotFoundError, files
try:
    found = [f for f in files("tbb") if f.name == "libtbb.so.12"]
    ctypes.CDLL(str(found[0].locate()), mode=ctypes.RTLD_GLOBAL)
except (PackageNotFoundError, IndexError):
    pass  # the system may have it
try:
    from ecospy import EcosSimulation, EcosSimulationStructure
except OSError as error:
    sys.exit(f"cannot load: {error}")
task = json.loads(sys.argv[1])
"""
_COSIM = """
import json, sys
try:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave
except OSError as error:
    sys.exit(f"cannot load: {error}")
task = json.loads(sys.argv[1])
"""
#: host -> its module, how its scripts begin, FMI versions that it reads
HOSTS = {"ecos": ("ecospy", _ECOS, ("2.0", "3.0")), "libcosim": ("libcosimpy", _COSIM, ("2.0",))}
READ = [(host, version) for host, (_, _, versions) in HOSTS.items() for version in versions]


def run_elsewhere(host: str, script: str, *task: object) -> list[float]:
    """What a script prints behind RESULT; `task` is what it has under that name.  Skips where the host is not there."""
    module, begin, _ = HOSTS[host]
    if find_spec(module) is None:
        pytest.skip(f"{module} is not installed (pip install phfmu[hosts])")
    command = [sys.executable, "-c", begin + script, json.dumps(task)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    if "cannot load" in done.stderr:
        pytest.skip(done.stderr.strip())
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-2000:]
    (line,) = [t for t in done.stdout.splitlines() if t.startswith("RESULT ")]
    return json.loads(line.removeprefix("RESULT "))
