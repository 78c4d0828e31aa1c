"""One importer's view of all versions: FMPy's bindings behind the same few calls."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.archive import ExtractedUnit
from phfmu.fmu.importer.refusal import UnitCallError, said
from phfmu.fmu.importer.unit_interface import Scalar
from phfmu.fmu.importer.values import Derivative, References
from phfmu.fmu.isolation import exit_guard, hang_guard, process_state
from phfmu.fmu.version import VERSIONS
from phfmu.fmu.words import plain

Array = NDArray[np.float64]

#: messages that are kept, those that are quoted, and the characters of one
KEPT, QUOTED, LONGEST = 20, 3, 500
#: the last status that is no refusal
WARNING = 1
#: of a step: the time at its end, as another one computes it
ROUNDING = 1e-9
_ANSWERS = {2: "discard", 3: "error", 4: "fatal", 5: "pending"}


#: instances that live in this process, of files that allow one
_LIVE: Counter[Path] = Counter()


class AnySlave(Protocol):
    """The interface of an instance to a unit, in this process or in one of its own."""

    words: deque[str]
    dead: bool
    absent: tuple[str, ...]

    def last_words(self) -> tuple[str, ...]: ...
    def references(self, scalars: Sequence[Scalar]) -> References: ...
    def set(self, r: References) -> None: ...
    def get(self, r: References) -> Array: ...
    def enter(self, start: float, stop: float | None, tolerance: float | None) -> None: ...
    def leave(self) -> None: ...
    def do_step(self, t: float, h: float, no_set_prior: bool) -> tuple[float, bool]: ...
    def reset(self) -> None: ...
    def save(self) -> Any: ...
    def restore(self, handle: Any) -> None: ...
    def forget(self, handle: Any) -> None: ...
    def serialize(self, handle: Any) -> bytes: ...
    def deserialize(self, data: bytes) -> Any: ...
    def derivative(self, d: Derivative) -> Array: ...
    def free(self) -> None: ...


class Slave:
    """An instance of a library.  Calls raise UnitCallError with the unit's own words."""

    def __init__(self, archive: ExtractedUnit, name: str, early_return: bool = False):
        about = archive.interface
        self._version = VERSIONS[about.version]
        self._names = self._version.code
        self.name, self.early_return = name, early_return
        self.words: deque[str] = deque(maxlen=KEPT)
        #: after a fatal error nothing may be called any more, not even to free it
        self.dead = False
        self._functions: dict[str, Any] = {}
        ours = bool(about.energy)  # quiet unless something is wrong; other units may say anything
        common: dict[str, Any] = {
            "guid": about.token, "modelIdentifier": about.identifier, "unzipDirectory": str(archive.folder),
            "instanceName": name,
        }  # fmt: skip
        self._alone = archive.path if about.one_instance else None
        if self._alone and _LIVE[self._alone]:
            raise FMUError(
                f"{archive.path}: '{name}' would be its second instance in this process, and it can have one "
                "(canBeInstantiatedOnlyOncePerProcess); give each a process of its own (--isolate)"
            )
        if exit_guard.arm():
            hang_guard.arm()
        self._foreign = not ours
        if self._foreign:
            process_state.arm()
        exit_guard.current = (name, "the start of its library", ())
        try:
            library = archive.folder / archive.library
            self.fmu: Any = self._names.instance(library, common, self._log, ours, early_return)
        except Exception as error:  # the bindings raise plain Exception for a library that does not load
            needs = "; it needs a tool of its maker on this machine (needsExecutionTool)" if about.tool else ""
            raise FMUError(f"{archive.path}: {plain(str(error))}{said(self.last_words())}{needs}") from error
        finally:
            exit_guard.current = None
            self._look("the start of its library")
        #: functions that its library lacks
        self.absent: tuple[str, ...] = self.fmu.absent
        if self._alone:
            _LIVE[self._alone] += 1

    def _look(self, function: str) -> None:
        if self._foreign:
            process_state.look(self.name, function)

    def _log(self, text: bytes | None) -> None:
        words = (text or b"")[: 4 * LONGEST].decode("utf-8", "replace").strip()
        self.words.append(plain(self._names.unescaped(words), LONGEST))

    @property
    def address(self) -> int:
        """Address of the instance, as functions of the library take it."""
        return int(self.fmu.component)

    def last_words(self) -> tuple[str, ...]:
        return tuple(self.words)[-QUOTED:]

    def call(self, function: Any, *arguments: Any) -> Any:
        """The call; UnitCallError with the last messages of the unit if it fails."""
        self._require_alive(function)
        self.words.clear()
        exit_guard.current = (self.name, function, arguments)
        try:
            return function(*arguments)
        except FMICallException as error:
            raise self.refused(error.function, error.status) from None
        finally:
            exit_guard.current = None

    def call_plain(self, function: str, arguments: tuple[Any, ...]) -> None:
        """`call` of a function of the library by its name, without the wrapper of the bindings: made many times a step."""
        known = self._functions.get(function)
        if known is None:
            known = self._functions[function] = getattr(self.fmu.dll, function)  # the bindings have declared its types
        self._require_alive(known)
        self.words.clear()
        exit_guard.current = (self.name, known, arguments)
        try:
            status = known(self.fmu.component, *arguments)
        finally:
            exit_guard.current = None
        if status > WARNING:
            raise self.refused(function, status)

    def _require_alive(self, function: Any) -> None:
        if self.dead:
            raise UnitCallError(self.name, _name(function), "fatal", ["it met a fatal error before"])

    def refused(self, function: str, status: int) -> UnitCallError:
        """The error of a call that was answered with this status; after a fatal one the unit is dead."""
        answer = _ANSWERS.get(status, f"status {status}")
        self.dead = answer == "fatal"
        return UnitCallError(self.name, function, answer, self.last_words())

    def references(self, scalars: Sequence[Scalar]) -> References:
        """Buffers for a group of scalars."""
        return References(scalars, self._version)

    def set(self, r: References) -> None:
        """Values of the buffer into the unit."""
        if r.direct is not None:
            self.call_plain(r.direct.setter, r.direct.arguments)
            return
        for b in r.by_type:
            if not b.filled:
                self.call_plain(b.getter, b.arguments)  # entries of arrays that stay as they are
            r.spread(b)
            self.call_plain(b.setter, b.arguments)

    def get(self, r: References) -> Array:
        """Values of the unit, in the buffer."""
        if r.direct is not None:
            self.call_plain(r.direct.getter, r.direct.arguments)
            return r.values
        for b in r.by_type:
            self.call_plain(b.getter, b.arguments)
            r.gather(b)
        return r.values

    def enter(self, start: float, stop: float | None, tolerance: float | None) -> None:
        """Into Initialization Mode; `tolerance`: relative, of the experiment, which a unit with steps of its own may follow."""
        self._names.enter(self, start, stop, tolerance)
        self._look("enterInitializationMode")

    def leave(self) -> None:
        self.call(self.fmu.exitInitializationMode)
        self._look("exitInitializationMode")

    def do_step(self, t: float, h: float, no_set_prior: bool) -> tuple[float, bool]:
        """The time reached, t + h unless the unit may return early or asks to end the simulation, and whether it does.

        no_set_prior: noSetFMUStatePriorToCurrentPoint, the promise that no state of a time before t will be restored.
        UnitCallError also if it returns early where it may not.
        """
        try:
            reached, ended = self._names.do_step(self, t, h, no_set_prior)
        finally:
            if self._foreign:
                process_state.look_quickly(self.name, t)
        return (_within(t, h, reached), True) if ended else (reached, False)

    def reset(self) -> None:
        self.call(self.fmu.reset)

    def save(self) -> Any:
        return self.call(self.fmu.getFMUState)

    def restore(self, handle: Any) -> None:
        self.call(self.fmu.setFMUState, handle)

    def forget(self, handle: Any) -> None:
        if not self.dead:
            self.call(self.fmu.freeFMUState, handle)

    def serialize(self, handle: Any) -> bytes:
        return self.call(self.fmu.serializeFMUState, handle)

    def deserialize(self, data: bytes) -> Any:
        return self.call(self.fmu.deserializeFMUState, data)

    def derivative(self, d: Derivative) -> Array:
        """Its values at the present time, in its buffer."""
        self.call_plain(f"{self._version.prefix}GetDirectionalDerivative", d.arguments)
        return d.buffer[d.picks]

    def free(self) -> None:
        if not self.dead:
            self.call(self.fmu.freeInstance)
            self._look("freeInstance")
            if self._alone:
                _LIVE[self._alone] -= 1


def _within(t: float, h: float, last: float) -> float:
    """The last successful time of a step at whose end, or in which, the unit asks to end; t where it tells none of it."""
    if abs(last - (t + h)) <= ROUNDING * h:
        return t + h
    return last if t < last < t + h else t


def _name(function: Any) -> str:
    return getattr(function, "__name__", str(function))
