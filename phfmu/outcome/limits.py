"""Limits of a step and tests of its solvers, the same in both engines: read from the headers of the runtime."""

from __future__ import annotations

import re
from pathlib import Path
from sys import float_info


def defined(*headers: Path) -> dict[str, float]:
    """Numbers that headers define, without the prefix PH_."""
    text = "".join(h.read_text() for h in headers)
    return {name: float(value) for name, value in re.findall(r"^#define PH_(\w+) ([\d.e+-]+)$", text, flags=re.M)}


def is_sliver(t: float, h: float, last: float) -> bool:
    """Whether a step of h from t is what rounding left of a master's clock; `last`: the internal step before it."""
    clock = LIMITS["SLIVER_CLOCK"] * float_info.epsilon * abs(t)
    return abs(h) <= max(clock, LIMITS["SLIVER_STEP"] * abs(last))


_RUNTIME = Path(__file__).parent.parent / "engine" / "runtime"
LIMITS = defined(_RUNTIME / "step_limits.h", _RUNTIME / "events" / "event_limits.h")
