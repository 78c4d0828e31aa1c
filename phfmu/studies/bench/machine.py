"""The machine, its load and the versions behind a measurement."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

from phfmu.processors import processors

PACKAGES = ("phfmu", "numpy", "scipy", "casadi", "scikit-sundae", "mujoco", "exudyn")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread() -> None:
    """Linear algebra in one thread; to be called before numpy is imported."""
    for name in THREADS:
        os.environ.setdefault(name, "1")


def processor() -> str:
    """Name of the processor and the number of its cores this process may use."""
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        found = [t.partition(":")[2].strip() for t in cpuinfo.read_text().splitlines() if t.startswith("model name")]
        name = found[0] if found else name
    return f"{name}, {processors()} cores, {platform.system()} {platform.machine()}"


def load() -> str:
    """Load averages over 1, 5 and 15 minutes, where the system has them."""
    return " ".join(f"{x:.2f}" for x in os.getloadavg()) if hasattr(os, "getloadavg") else "unknown"


def versions(packages: Sequence[str] = PACKAGES) -> str:
    """Python, the packages that are there, and the C compiler."""
    from phfmu.engine.build.compile import CompilerMissing, require_compiler

    found = [f"Python {platform.python_version()}"]
    for p in packages:
        try:
            found.append(f"{p} {metadata.version(p)}")
        except metadata.PackageNotFoundError:
            continue
    try:
        found.append(require_compiler())
    except CompilerMissing:
        found.append("no C compiler")
    return ", ".join(found)
