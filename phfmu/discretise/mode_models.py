"""The discretised model of every mode of a declaration with switches, built when it is first stepped."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from phfmu.declare.phdae import PHDAE
from phfmu.events.modes import Mode, Modes

M = TypeVar("M")


class ModeModels(Generic[M]):
    """Models by mode; `make` discretises a declaration without switches."""

    def __init__(self, modes: Modes, make: Callable[[PHDAE], M]):
        self.modes, self._make = modes, make
        self._known: dict[Mode, M] = {}

    def __getitem__(self, mode: Mode) -> M:
        if mode not in self._known:
            self._known[mode] = self._make(self.modes.declared(mode))
        return self._known[mode]

    @property
    def known(self) -> list[Mode]:
        """Modes that were built, in that order."""
        return list(self._known)
