"""Native engines under gcc's sanitizers: a child process that compiles all C with them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SANITIZE = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
#: what the child does first: everything in C is compiled with them; the tests' own modules are found behind all others
PREAMBLE = f"""
import importlib.util, sys
sys.path.append({str(Path(__file__).parents[1])!r})
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "ziglang" else find(name, *more)
from phfmu.engine.build import compile as c
c.FLAGS = (*(f for f in c.FLAGS if f != "-O2"), "-O0", "-g1", *{SANITIZE})
c.LINK = ("-shared", *{SANITIZE})
"""


def preloaded(cache: Path) -> dict[str, str]:
    """Environment with the run-time of gcc's sanitizers and a cache of its own; else the test is skipped with the reason."""
    gcc = shutil.which("gcc")
    if gcc is None or not sys.platform.startswith("linux"):
        pytest.skip("needs gcc on Linux")
    found = []
    for name in ("libasan.so", "libubsan.so"):
        path = subprocess.run([gcc, f"-print-file-name={name}"], capture_output=True, text=True).stdout.strip()
        if not Path(path).is_file():
            pytest.skip(f"gcc has no {name}")
        found.append(path)
    environment = os.environ | {
        "LD_PRELOAD": " ".join(found),
        "ASAN_OPTIONS": "detect_leaks=0",
        "PHFMU_CACHE_DIR": str(cache),
    }
    if subprocess.run([sys.executable, "-c", "import numpy, casadi"], env=environment, capture_output=True).returncode:
        pytest.skip("this Python does not run under the address sanitizer")
    return environment


def output(code: str, cache: Path) -> list[str]:
    """The words that `code` prints in such a process."""
    environment = preloaded(cache)
    command = [sys.executable, "-c", PREAMBLE + code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout.split()
