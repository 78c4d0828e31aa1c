"""A unit in a process of its own: a crash, a hang, an exit or output of its library is that of the process."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.archive import ExtractedUnit
from phfmu.fmu.importer.refusal import UnitCallError, UnitFailure
from phfmu.fmu.importer.slave import KEPT, LONGEST, QUOTED, AnySlave, Slave
from phfmu.fmu.importer.unit_interface import Scalar
from phfmu.fmu.importer.values import Derivative, References
from phfmu.fmu.isolation.child import AnswerTimeout, Child, ProcessEnded
from phfmu.fmu.isolation.unit_process import GIVEN, REFUSED
from phfmu.fmu.version import VERSIONS
from phfmu.fmu.words import plain

Array = NDArray[np.float64]

#: lines of what a library prints that are passed on
SHOWN = 20
#: s that a process may take until it is there
START = 120.0

#: verb -> function of the standard, less its version
_FUNCTIONS = {
    "begin": "Instantiate", "enter": "EnterInitializationMode", "leave": "ExitInitializationMode", "do_step": "DoStep",
    "get": "Get..", "set": "Set..", "save": "GetFMUState", "restore": "SetFMUState", "reset": "Reset",
    "derivative": "GetDirectionalDerivative", "serialize": "SerializeFMUState", "deserialize": "DeserializeFMUState",
}  # fmt: skip


class RemoteSlave:
    """The twin of `Slave`; each call waits `timeout` s at most.  UnitFailure if the process ended or did not answer in time.

    What the library prints is passed on to stderr, with the name of the unit.
    """

    def __init__(self, archive: ExtractedUnit, name: str, early_return: bool, timeout: float):
        self.name, self.early_return, self.timeout = name, early_return, timeout
        self.words: deque[str] = deque(maxlen=KEPT)
        self.dead = False
        self._version = VERSIONS[archive.interface.version]
        self._time, self._step = 0.0, 0.0
        self._groups: dict[tuple[str, ...], int] = {}
        self._forgotten: list[int] = []
        self._printed: deque[str] = deque(maxlen=QUOTED)
        self._lines = 0
        self._child = Child("phfmu.fmu.isolation.unit_process", self._pass_on)
        self._received("start", START)
        told = [str(archive.path.resolve()), str(archive.folder), archive.library, name, early_return]
        self.absent: tuple[str, ...] = tuple(self._message(told, "begin"))

    # -- the process ------------------------------------------------------------------------------------------

    def _pass_on(self, line: bytes) -> None:
        """A line of output of the library."""
        text = plain(line.decode("utf-8", "replace").rstrip(), LONGEST)
        self._printed.append(text)
        self._lines += 1
        if self._lines <= SHOWN:
            print(f"{self.name}: {text}", file=sys.stderr, flush=True)
        elif self._lines == SHOWN + 1:
            print(f"{self.name}: prints more than {SHOWN} lines; the others are left out", file=sys.stderr, flush=True)

    def _ask(self, verb: str, *arguments: Any) -> Any:
        return self._message([verb, arguments], verb)

    def _message(self, message: Any, verb: str) -> Any:
        """The message that is given; the errors of `Slave`, and UnitFailure."""
        function = f"{self._version.prefix}{_FUNCTIONS.get(verb, verb)}"
        if self.dead:
            raise UnitCallError(self.name, function, "fatal", ["it met a fatal error before"])
        try:
            self._child.tell(message)
        except ProcessEnded as lost:
            raise self._lost(f"{function}: {lost}", "gone") from None
        return self._received(function, self.timeout)

    def _received(self, function: str, timeout: float) -> Any:
        try:
            found = self._child.answer(timeout)
        except AnswerTimeout:
            raise self._lost(f"{function}: no answer in {timeout:g} s", "hang") from None
        except ProcessEnded as lost:
            raise self._lost(f"{function}: {lost}", "gone") from None
        except KeyboardInterrupt:  # its answer would be taken for that of the next call
            self.dead = True
            self._child.kill()
            raise
        kind, what = found
        if kind == GIVEN:
            return what
        if kind == REFUSED:
            called, reply, words, self.dead = what
            self.words.extend(words)
            raise UnitCallError(self.name, called, reply, words)
        raise FMUError(what)

    def _lost(self, what: str, answer: str) -> UnitFailure:
        self.dead = True
        self._child.kill()
        return UnitFailure(self.name, self._time, self._step, what, answer, [*self._printed])

    def last_words(self) -> tuple[str, ...]:
        return tuple(self._printed)[-QUOTED:]

    # -- calls --------------------------------------------------------------------------------------------------

    def _group(self, r: References) -> int:
        """Its number in the process; named at the first time."""
        names = tuple(s.name for s in r.scalars)
        if names not in self._groups:
            self._groups[names] = self._ask("group", names)
        return self._groups[names]

    def references(self, scalars: Sequence[Scalar]) -> References:
        """Buffers for a group of scalars."""
        return References(scalars, self._version)

    def set(self, r: References) -> None:
        if r.n:
            self._ask("set", self._group(r), r.values.tolist())

    def get(self, r: References) -> Array:
        if r.n:
            r.values[:] = self._ask("get", self._group(r))
        return r.values

    def enter(self, start: float, stop: float | None, tolerance: float | None) -> None:
        self._time = start
        self._ask("enter", start, stop, tolerance)

    def leave(self) -> None:
        self._ask("leave")

    def do_step(self, t: float, h: float, no_set_prior: bool) -> tuple[float, bool]:
        self._time, self._step = t, h
        reached, ended = self._ask("do_step", t, h, no_set_prior)
        self._time, self._step = reached, 0.0
        return reached, ended

    def reset(self) -> None:
        self._ask("reset")

    def save(self) -> int:
        self._clear()
        return self._ask("save")

    def restore(self, handle: int) -> None:
        self._ask("restore", handle)

    def forget(self, handle: int) -> None:
        """Told with the next state: nobody knows in the middle of which call the last holder of a state lets it go."""
        self._forgotten.append(handle)

    def serialize(self, handle: int) -> bytes:
        return bytes.fromhex(self._ask("serialize", handle))

    def deserialize(self, data: bytes) -> int:
        return self._ask("deserialize", data.hex())

    def derivative(self, d: Derivative) -> Array:
        return np.array(self._ask("derivative", self._group(d.unknowns), d.known.name))

    def _clear(self) -> None:
        if self._forgotten:
            states, self._forgotten = self._forgotten, []
            self._ask("forget", states)

    def free(self) -> None:
        """The unit, and the process."""
        if not self.dead:
            try:
                self._clear()
                self._ask("free")
            except (UnitFailure, FMUError) as error:
                print(f"{self.name}: {error}", file=sys.stderr)
        self.dead = True
        self._child.close()


def slave_of(unit: ExtractedUnit, name: str, early_return: bool, isolate: float | None) -> AnySlave:
    """A slave in this process, or in one of its own, where a call may take `isolate` s."""
    return Slave(unit, name, early_return) if isolate is None else RemoteSlave(unit, name, early_return, isolate)
