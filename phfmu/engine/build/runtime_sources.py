"""The hand-written C of the runtime: which files its libraries are made of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

RUNTIME = Path(__file__).parent.parent / "runtime"

#: folders of the runtime that not everything has, and those of them that the library has which steps all models
PARTS = ("events", "modes", "interpret", "reverse")
STEPS = ("events", "modes", "interpret")
#: whose folders `runtime` have what drives steps: the judge of ledgers, steps that keep a tolerance, sweeps, the master of
#: coupled members
DRIVERS = ("audit", "runs/march", "sweeps", "network/couplings")


def runtime_sources(*parts: str) -> dict[str, Path]:
    """The hand-written part of a library: file name -> path; with those of its folders PARTS that are asked for."""
    absent = set(PARTS).difference(parts)
    files = (p for p in sorted(RUNTIME.rglob("*")) if p.parent.name not in absent)
    return {p.name: p for p in files if p.suffix in (".c", ".h", ".inc")}


def driver_sources(*places: str) -> dict[str, Path]:
    """The sources of some of the DRIVERS: file name -> path."""
    folders = (RUNTIME.parent.parent / place / "runtime" for place in places)
    return {p.name: p for folder in folders for p in sorted(folder.iterdir())}


def library_sources() -> dict[str, Path]:
    """All of the library that steps models and drives these steps."""
    return runtime_sources(*PARTS) | driver_sources(*DRIVERS)


def headers() -> dict[str, Path]:
    """The headers that the code of a model includes."""
    return {name: path for name, path in runtime_sources(*PARTS).items() if not name.endswith(".c")}


def _summing() -> dict[str, Path]:
    return driver_sources("audit") | {name: RUNTIME / name for name in ("real.h", "judge.h", "names.h")}


#: the sources of the libraries that all models have in common, by name
LIBRARIES: dict[str, Callable[[], dict[str, Path]]] = {
    "steps": lambda: runtime_sources(*STEPS),
    "backwards": lambda: runtime_sources(*PARTS),
    "drivers": library_sources,
    "summing": _summing,
}
