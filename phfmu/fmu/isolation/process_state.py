"""The state of the process stays as it was, whatever the library of a foreign unit does to it.

A library may change the rounding of every later number (`fesetround`, or flushing of denormal numbers, which some compilers
switch on as a library is loaded), make faults of floating-point exceptions, ignore or block the signals that end this process,
or make a copy of it (`fork`) that comes back from the call.  All of it is put back after the library was loaded and after it was
initialised; after a step the arithmetic and the copy at once, and signals as often as a person would notice.  Windows has other
calls for all of these; nothing is done there.
"""

from __future__ import annotations

import ctypes
import os
import signal
import threading
import time
from contextlib import suppress
from ctypes.util import find_library
from functools import partial
from typing import Any

#: s between looks at what no number depends on
PAUSE = 0.1

#: signals that end, stop or inform this process; those of faults belong to whoever wants them
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGPIPE", "SIGCHLD", "SIGALRM", "SIGTSTP")
_SIGNALS = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
_SIZE = 512  # bytes, more than any fenv_t and struct sigaction


class _Before:
    """The process as it was before the first foreign library."""

    def __init__(self) -> None:
        maths = ctypes.CDLL(find_library("m"))
        maths.fesetenv.argtypes = [ctypes.c_void_p]
        self.library = ctypes.CDLL(None)
        self.arithmetic = ctypes.create_string_buffer(_SIZE)
        maths.fegetenv(self.arithmetic)
        #: rounding, denormal numbers and which exceptions are faults, as they were
        self.put_back = partial(maths.fesetenv, ctypes.addressof(self.arithmetic))
        self.blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
        self._action = ctypes.create_string_buffer(_SIZE)
        #: the function of the interpreter that hears signals which have a handler in Python
        self.hears = next((self.handler(n) for n in _SIGNALS if callable(signal.getsignal(n))), None)
        #: those that somebody handles outside of the interpreter
        self.others = {n for n in _SIGNALS if self.handler(n) != self.expected(n)}
        self.process = os.getpid()

    def handler(self, number: int) -> int:
        """The function that takes a signal; 0: the default, 1: it is ignored."""
        self.library.sigaction(number, None, self._action)
        return ctypes.c_void_p.from_buffer(self._action).value or 0

    def expected(self, number: int) -> int | None:
        """The same as the interpreter knows it."""
        known: Any = signal.getsignal(number)
        return self.hears if callable(known) else None if known is None else int(known)


_before: _Before | None = None
_next_look = 0.0


def arm() -> None:
    """Once a process, before the first library; where there are such calls."""
    global _before
    if _before is None and os.name == "posix":
        _before = _Before()
        os.register_at_fork(after_in_child=_forked)


def look(unit: str, function: str) -> None:
    """Puts back what the library has changed; a copy of the process ends here."""
    global _next_look
    if _before is None:
        return
    if os.getpid() != _before.process:
        _end_copy(unit, function)
    _before.put_back()
    _next_look = time.monotonic() + PAUSE
    if threading.current_thread() is threading.main_thread():
        _hear_again(_before)


def look_quickly(unit: str, t: float) -> None:
    """The same after a step from time t: signals only now and then."""
    if _before is None:
        return
    _before.put_back()
    if os.getpid() != _before.process or time.monotonic() > _next_look:
        look(unit, f"doStep at t = {t:.9g} s")


def _hear_again(before: _Before) -> None:
    for number in _SIGNALS:
        expected = before.expected(number)
        if number not in before.others and expected is not None and before.handler(number) != expected:
            signal.signal(number, signal.getsignal(number))
    blocked = {n for n in signal.pthread_sigmask(signal.SIG_BLOCK, ()) if n in _SIGNALS} - before.blocked
    if blocked:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, blocked)


def _forked() -> None:
    """A copy that the interpreter made, which may go on."""
    if _before is not None:
        _before.process = os.getpid()


def _end_copy(unit: str, function: str) -> None:
    text = f"phfmu: the unit '{unit}' made a copy of this process (fork) that came back from {function}; the copy ends here\n"
    with suppress(OSError):
        os.write(2, text.encode())
    os._exit(3)
