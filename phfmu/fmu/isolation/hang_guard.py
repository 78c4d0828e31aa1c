"""A unit that does not answer does not keep a process from being ended by Ctrl-C, SIGTERM or the end of its terminal.

Python's handlers of signals run between calls into libraries, so never while one hangs.  A thread hears of signals at once
(`signal.set_wakeup_fd`), says at the first one which unit is waited for, and ends the process at a second one in the same call.
"""

from __future__ import annotations

import atexit
import os
import signal
import socket
import threading
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from phfmu.fmu.isolation import exit_guard

#: s after a signal in which the call may end, so that Python's handlers take it
GRACE = 0.5

_ENDS = {getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)}
_armed: list[socket.socket] = []  # both ends of the pipe, which must not be collected


def arm() -> None:
    """Once a process, by its main thread; not where something else listens already (an event loop)."""
    if threading.current_thread() is not threading.main_thread():
        return
    heard, told = socket.socketpair()
    told.setblocking(False)
    other = signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)
    if other != -1:
        signal.set_wakeup_fd(other)
        return
    _armed.extend((heard, told))
    threading.Thread(target=_listen, args=(heard,), daemon=True).start()
    atexit.register(_disarm)


def _disarm() -> None:
    """At the end of the process, whose interpreter would complain of sockets that are left open."""
    signal.set_wakeup_fd(-1)
    while _armed:
        _armed.pop().close()


def _listen(heard: socket.socket) -> None:
    first: _Waited | None = None  # what was under way when a signal came
    while number := heard.recv(1):
        if number[0] not in _ENDS or not (calls := exit_guard.calls()):
            continue
        waited = _Waited(exit_guard.current, calls)
        threading.Event().wait(GRACE)
        if not waited.goes_on():  # it answered
            continue
        if first is not None and first.goes_on():
            exit_guard.leave(f"does not answer in {exit_guard.under_way()}", "a second signal", 128 + number[0])
        first = waited
        with suppress(OSError):
            text = f"phfmu: waiting for the unit '{calls[0][0]}', {exit_guard.under_way()}; a second signal ends it there\n"
            os.write(2, text.encode())


@dataclass(frozen=True)
class _Waited:
    """`exit_guard.current` and the calls that it told of at some time."""

    current: Any
    calls: list[exit_guard.Call]

    def goes_on(self) -> bool:
        """Whether they are under way still; arguments of one call are arrays, which are not compared."""
        return exit_guard.current is self.current and (not callable(self.current) or exit_guard.calls() == self.calls)
