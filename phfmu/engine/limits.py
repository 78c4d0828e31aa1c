"""Limits of a step and tests of its solvers, the same in both engines: read from the headers of the runtime."""

from __future__ import annotations

import re
from pathlib import Path


def _read() -> dict[str, float]:
    folder = Path(__file__).parent / "runtime"
    text = "".join((folder / name).read_text() for name in ("step_limits.h", "events/event_limits.h"))
    return {name: float(value) for name, value in re.findall(r"^#define PH_(\w+) ([\d.e+-]+)$", text, flags=re.M)}


LIMITS = _read()
