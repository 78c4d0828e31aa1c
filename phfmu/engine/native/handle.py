"""Addresses of a native instance and of what belongs to it, for compiled code that steps it itself."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phfmu.engine.native.derivatives import NativeChain, NativeImpulses


@dataclass(frozen=True)
class Handle:
    """Library and addresses, those of the instance, which must outlive who uses them.

    kicked: its impulses if there are any yet;  check: raises what a status means;  impulses, tangents: makes them, and
    compiles for it what they need
    """

    lib: ctypes.CDLL
    instance: int
    state_size: int
    signals: int
    node_outputs: int
    kicked: NativeImpulses | None
    check: Callable[[int], None]
    impulses: Callable[[], NativeImpulses]
    tangents: Callable[[], NativeChain]
