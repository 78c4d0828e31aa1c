"""Functional Mock-up Units: `export` writes them, FMUInstance steps them."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.fmu.export.manifest import PortMap
    from phfmu.fmu.export.variables import FMUError
    from phfmu.fmu.importer.reader import FMUInstance

_HOME = {"PortMap": "export.manifest", "FMUInstance": "importer.reader", "FMUError": "export.variables"}

__all__ = ["FMUError", "FMUInstance", "PortMap"]


def __getattr__(name: str) -> Any:
    """Modules are imported when needed: reading a unit needs no compiler, writing one no importer."""
    if name not in _HOME:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
