"""The process of one unit: what `RemoteSlave` asks of it, on its input, is answered on its output.

Messages are a length of four bytes and JSON.  What the library prints goes where errors go, so that nothing mixes with answers.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

LENGTH = 4

# what an answer is
GIVEN, REFUSED, WRONG = "given", "refused", "wrong"


def write(stream: IO[bytes], message: Any) -> None:
    data = json.dumps(message).encode()
    stream.write(len(data).to_bytes(LENGTH, "big") + data)
    stream.flush()


def read(stream: IO[bytes]) -> Any:
    """The next message; None where there are no more, or it is torn."""
    head = stream.read(LENGTH)
    data = stream.read(int.from_bytes(head, "big")) if len(head) == LENGTH else b""
    return json.loads(data) if data and len(data) == int.from_bytes(head, "big") else None


class Server:
    """A unit, and by number the groups of variables and the states that were named before."""

    def __init__(self, path: str, folder: str, library: str, name: str, early_return: bool):
        from phfmu.fmu.importer.archive import ExtractedUnit, open_archive
        from phfmu.fmu.importer.slave import Slave

        self.interface = open_archive(path).interface
        self.slave = Slave(ExtractedUnit(Path(path), Path(folder), library, self.interface), name, early_return)
        self.groups: list[Any] = []
        self.states: dict[int, Any] = {}
        self._number = 0

    def group(self, names: list[str]) -> int:
        self.groups.append(self.slave.references(self.interface.scalars(names, "variable")))
        return len(self.groups) - 1

    def enter(self, start: float, stop: float | None, tolerance: float | None) -> None:
        self.slave.enter(start, stop, tolerance)

    def leave(self) -> None:
        self.slave.leave()

    def reset(self) -> None:
        self.slave.reset()

    def set(self, group: int, values: list[float]) -> None:
        self.groups[group].values[:] = values
        self.slave.set(self.groups[group])

    def get(self, group: int) -> list[float]:
        return self.slave.get(self.groups[group]).tolist()

    def do_step(self, t: float, h: float, no_set_prior: bool) -> tuple[float, bool]:
        return self.slave.do_step(t, h, no_set_prior)

    def save(self) -> int:
        return self._kept(self.slave.save())

    def restore(self, state: int) -> None:
        self.slave.restore(self.states[state])

    def forget(self, states: list[int]) -> None:
        for state in states:
            self.slave.forget(self.states.pop(state))

    def serialize(self, state: int) -> str:
        return self.slave.serialize(self.states[state]).hex()

    def deserialize(self, data: str) -> int:
        return self._kept(self.slave.deserialize(bytes.fromhex(data)))

    def derivative(self, group: int, known: str) -> list[float]:
        from phfmu.fmu.importer.values import Derivative
        from phfmu.fmu.version import VERSIONS

        version = VERSIONS[self.interface.version]
        (given,) = self.interface.scalars([known], "variable")
        return self.slave.derivative(Derivative(self.groups[group], given, version)).tolist()

    def free(self) -> None:
        self.slave.free()

    def _kept(self, handle: Any) -> int:
        self._number += 1
        self.states[self._number] = handle
        return self._number


def answer(server: Server, verb: str, arguments: list[Any]) -> tuple[str, Any]:
    """The answer of a verb of `Server`, or why there is none."""
    from phfmu.fmu.export.variables import FMUError
    from phfmu.fmu.importer.refusal import UnitCallError

    asked: Callable[..., Any] = getattr(server, verb)
    try:
        return GIVEN, asked(*arguments)
    except UnitCallError as error:
        return REFUSED, [error.function, error.answer, list(error.words), server.slave.dead]
    except FMUError as error:
        return WRONG, str(error)


def end_with_parent() -> None:
    """Linux ends this process with the one that started it, also in the middle of a call."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def connected() -> tuple[IO[bytes], IO[bytes]]:
    """The streams of questions and answers of this process, which serves and ends with the one that started it.

    A library finds no input, and prints where errors go.
    """
    from phfmu.fmu.isolation import exit_guard

    asked, told = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who started it ends it
    exit_guard.leave_alone()
    end_with_parent()
    return asked, told


def serve() -> None:
    """Until the input ends."""
    asked, told = connected()
    from phfmu.fmu.export.variables import FMUError

    write(told, (GIVEN, None))
    try:
        server = Server(*read(asked))
    except FMUError as error:
        write(told, (WRONG, str(error)))
        os._exit(0)
    write(told, (GIVEN, server.slave.absent))
    while (message := read(asked)) is not None:
        write(told, answer(server, *message))
    sys.stdout.flush()
    os._exit(0)  # libraries are not asked whether they can be unloaded
