"""Limits of a step and tests of its solvers, the same in both engines: read from the headers of the runtime."""

from __future__ import annotations

import re
from pathlib import Path


def defined(*headers: Path) -> dict[str, float]:
    """Numbers that headers define, without the prefix PH_."""
    text = "".join(h.read_text() for h in headers)
    return {name: float(value) for name, value in re.findall(r"^#define PH_(\w+) ([\d.e+-]+)$", text, flags=re.M)}


_RUNTIME = Path(__file__).parent / "runtime"
LIMITS = defined(_RUNTIME / "step_limits.h", _RUNTIME / "events" / "event_limits.h")
