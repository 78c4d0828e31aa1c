"""Limits of a step and tests of its solvers, the same in both engines: read from runtime/step_limits.h."""

from __future__ import annotations

import re
from pathlib import Path


def _read() -> dict[str, float]:
    text = (Path(__file__).parent / "runtime" / "step_limits.h").read_text()
    return {name: float(value) for name, value in re.findall(r"^#define PH_(\w+) ([\d.e+-]+)$", text, flags=re.M)}


LIMITS = _read()
