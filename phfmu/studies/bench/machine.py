"""The machine, its load and the versions behind a measurement."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from time import thread_time

from phfmu.processors import processors

PACKAGES = ("phfmu", "numpy", "scipy", "casadi", "scikit-sundae", "mujoco", "exudyn")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread() -> None:
    """Linear algebra in one thread; to be called before numpy is imported."""
    for name in THREADS:
        os.environ.setdefault(name, "1")


def processor_name() -> str:
    """Name of the processor, as far as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    found = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(found, platform.processor() or platform.machine())


def processor() -> str:
    """Name of the processor and the number of its cores this process may use."""
    return f"{processor_name()}, {processors()} cores, {platform.system()} {platform.machine()}"


def load() -> str:
    """Load averages over 1, 5 and 15 minutes, where the system has them."""
    return " ".join(f"{x:.2f}" for x in os.getloadavg()) if hasattr(os, "getloadavg") else "unknown"


def machine_line(before: str = "") -> str:
    """The processor and the load of the machine; `before`: what the load was before a measurement."""
    now = f"load {before} before, {load()} after" if before else f"load {load()}"
    return f"{processor()}; {now}"


def installed(packages: Sequence[str]) -> dict[str, str]:
    """Versions of those of the packages that are there."""
    found = {}
    for p in packages:
        try:
            found[p] = metadata.version(p)
        except metadata.PackageNotFoundError:
            continue
    return found


def cpu_seconds(take: Callable[[], object]) -> float:
    """CPU time of this thread in a call [s]."""
    before = thread_time()
    take()
    return thread_time() - before


def versions(packages: Sequence[str] = PACKAGES) -> str:
    """Python, the packages that are there, and the C compiler."""
    from phfmu.engine.build.compile import CompilerMissing, require_compiler

    found = [f"Python {platform.python_version()}", *(f"{p} {v}" for p, v in installed(packages).items())]
    try:
        found.append(require_compiler())
    except CompilerMissing:
        found.append("no C compiler")
    return ", ".join(found)
