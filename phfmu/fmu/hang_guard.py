"""A unit that does not answer does not keep a process from being ended by Ctrl-C, SIGTERM or the end of its terminal.

Python's handlers of signals run between calls into libraries, so never while one hangs.  A thread hears of signals at once
(`signal.set_wakeup_fd`), says at the first one which unit is waited for, and ends the process at a second one in the same call.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
from contextlib import suppress

from phfmu.fmu import exit_guard

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


def _listen(heard: socket.socket) -> None:
    first: list[exit_guard.Call] = []  # what was under way when a signal came
    while number := heard.recv(1):
        if number[0] not in _ENDS or not (calls := exit_guard.calls()):
            continue
        threading.Event().wait(GRACE)
        if exit_guard.calls() != calls:  # it answered
            continue
        if first == calls:
            exit_guard.leave(f"does not answer in {exit_guard.under_way()}", "a second signal", 128 + number[0])
        first = calls
        with suppress(OSError):
            text = f"phfmu: waiting for the unit '{calls[0][0]}', {exit_guard.under_way()}; a second signal ends it there\n"
            os.write(2, text.encode())
