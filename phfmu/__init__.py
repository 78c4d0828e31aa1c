"""phfmu: port-Hamiltonian DAEs as co-simulation components whose energy balance is exact.

The public names are listed in `__init__.pyi`, one import a line.  They are loaded when they are first used, so that importing
the package costs nothing.
"""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"


def _listed() -> dict[str, str]:
    """Public name -> module that defines it."""
    with open(__file__ + "i", encoding="utf-8") as stub:
        words = [line.split() for line in stub if line.startswith("from ")]
    return {name: module for _, module, _, name, *_ in words}


_OWNER = _listed()
__all__ = tuple(_OWNER)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _OWNER:
        raise AttributeError(f"module 'phfmu' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(_OWNER[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_OWNER])
