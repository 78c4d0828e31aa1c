"""One importer's view of both versions: FMPy's bindings behind the same few calls."""

from __future__ import annotations

import ctypes
from collections import deque
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

from phfmu.fmu.archive import Archive
from phfmu.fmu.variables import FMUError

Array = NDArray[np.float64]


class References:
    """Value references as the library wants them, with a buffer for their values."""

    def __init__(self, references: list[int]):
        self.n = len(references)
        room = max(self.n, 1)  # ctypes wants memory, also for nothing
        self.references = (ctypes.c_uint * room)(*references)
        self.address = (ctypes.c_double * room)()
        self.values = np.ctypeslib.as_array(self.address)[: self.n]


class Slave:
    """An instance of a library.  Calls raise FMUError with the unit's own words."""

    def __init__(self, archive: Archive, name: str):
        about = archive.interface
        self.two = about.version == "2.0"
        self.name = name
        self.words: deque[str] = deque(maxlen=20)
        common: dict[str, Any] = {
            "guid": about.token, "modelIdentifier": about.identifier, "unzipDirectory": str(archive.folder),
            "instanceName": name,
        }  # fmt: skip
        try:
            if self.two:
                self.fmu: Any = FMU2Slave(libraryPath=str(archive.folder / archive.library), **common)
                self.fmu.instantiate(callbacks=self._callbacks())
            else:
                self.fmu = FMU3Slave(**common)
                self.fmu.instantiate(logMessage=lambda _environment, status, _category, text: self._log(status, text))
        except Exception as error:  # the bindings raise plain Exception for a library that does not load
            raise FMUError(f"{archive.path}: {error}{self._last_words()}") from error
        self._get, self._set = (
            (self.fmu.fmi2GetReal, self.fmu.fmi2SetReal)
            if self.two
            else (self.fmu.fmi3GetFloat64, self.fmu.fmi3SetFloat64)
        )

    def _callbacks(self) -> fmi2CallbackFunctions:
        import fmpy

        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(
            lambda _environment, _name, status, _category, text: self._log(status, text)
        )
        callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(fmpy.free)
        return callbacks

    def _log(self, status: int, text: bytes) -> None:
        words = (text or b"").decode("utf-8", "replace")
        if self.two:
            words = words.replace("%%", "%").replace("##", "#")
        self.words.append(words)

    def _last_words(self) -> str:
        return f"; it says: {self.words[-1]}" if self.words else ""

    def call(self, function: Any, *arguments: Any) -> Any:
        """The call; FMUError with the last message of the unit if it fails."""
        self.words.clear()
        try:
            return function(*arguments)
        except FMICallException as error:
            raise FMUError(f"{self.name}: {error}{self._last_words()}") from None

    def set(self, r: References) -> None:
        """Values of the buffer into the unit."""
        count = () if self.two else (r.n,)
        self.call(self._set, self.fmu.component, r.references, r.n, r.address, *count)

    def get(self, r: References) -> Array:
        """Values of the unit, in the buffer."""
        count = () if self.two else (r.n,)
        self.call(self._get, self.fmu.component, r.references, r.n, r.address, *count)
        return r.values

    def enter(self, start: float, stop: float | None) -> None:
        """Into Initialization Mode."""
        if self.two:
            self.call(self.fmu.setupExperiment, None, start, stop)
            self.call(self.fmu.enterInitializationMode)
        else:
            self.call(self.fmu.enterInitializationMode, None, start, stop)

    def leave(self) -> None:
        self.call(self.fmu.exitInitializationMode)

    def do_step(self, t: float, h: float) -> None:
        self.call(self.fmu.doStep, t, h, False)

    def reset(self) -> None:
        self.call(self.fmu.reset)

    def save(self) -> Any:
        return self.call(self.fmu.getFMUState)

    def restore(self, handle: Any) -> None:
        self.call(self.fmu.setFMUState, handle)

    def forget(self, handle: Any) -> None:
        self.call(self.fmu.freeFMUState, handle)

    def serialize(self, handle: Any) -> bytes:
        return self.call(self.fmu.serializeFMUState, handle)

    def deserialize(self, data: bytes) -> Any:
        return self.call(self.fmu.deserializeFMUState, data)

    def derivative(self, unknowns: list[int], known: int) -> list[float]:
        """d unknowns / d known."""
        return self.call(self.fmu.getDirectionalDerivative, unknowns, [known], [1.0])

    def free(self) -> None:
        self.fmu.freeInstance()
