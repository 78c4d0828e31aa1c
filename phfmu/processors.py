"""Number of processors of this process."""

from __future__ import annotations

import os


def processors() -> int:
    """Processors that it may use, where the system tells; else all of the machine."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
