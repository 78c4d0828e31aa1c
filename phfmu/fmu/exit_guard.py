"""A unit that ends the process (`exit` in its library, a crash) does not do so unnoticed.

While a call into a unit is under way its name stands here.  A handler that the C library runs on `exit`, and one for signals
that a fault raises, find it, say which unit ended the process, in which call and how, and leave with exit code 3.
Handlers of `exit` are taken back (`__cxa_finalize`) before the interpreter ends, so none of it runs on an ordinary
end; only glibc and macOS can do that.  Of a signal, a handler that something else has set (another language's runtime)
stays; that of faulthandler still prints its traceback.  `_exit`, SIGKILL and an exhausted stack leave no time for any handler.
"""

from __future__ import annotations

import atexit
import ctypes
import faulthandler
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

#: exit code of a run that did not reach its end
CODE = 3
#: time in s after which a handler that hangs, since the memory it works with is broken, is ended
PATIENCE = 5

#: a call: name of the unit, the function or its name, the arguments
Call = tuple[str, Any, tuple[Any, ...]]
#: the call that is under way; of those that compiled code makes, what tells; between calls there is none
current: Call | Callable[[], list[Call]] | None = None

#: what there is of the run that it ends, in words
left: tuple[str, ...] = ()

_FAULTS = {
    "SIGSEGV": "it used memory that is not its own",
    "SIGBUS": "it used memory that is not there",
    "SIGFPE": "a fault in arithmetic",
    "SIGILL": "an instruction that this machine does not have",
    "SIGABRT": "its library called abort, or an assertion failed",
}

_armed: list[Any] = []  # what must not be collected while the C library may call it
_before: dict[int, Any] = {}  # handlers of signals that ours took the place of


def arm() -> bool:
    """Once a process; each part where the C library can do it.  Whether it was done now."""
    if _armed:
        return False
    _armed.append(None)
    if sys.platform == "win32":
        return False
    library = ctypes.CDLL(None)
    if _can_take_back():
        handle = ctypes.c_char()
        handler = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_exits)
        _armed.extend((handle, handler))
        library.__cxa_atexit(handler, None, ctypes.byref(handle))
        atexit.register(lambda: library.__cxa_finalize(ctypes.byref(handle)))  # finds no call
    _arm_signals(library)
    return True


def leave_alone() -> None:
    """Not in a process that is the unit's own, whose end another one sees."""
    _armed.append(None)


def _can_take_back() -> bool:
    if sys.platform == "darwin":
        return True
    try:
        return (os.confstr("CS_GNU_LIBC_VERSION") or "").startswith("glibc")
    except (AttributeError, ValueError, OSError):
        return False


def _arm_signals(library: ctypes.CDLL) -> None:
    set_handler = library.signal
    set_handler.restype, set_handler.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_void_p)

    def fault(number: int) -> None:
        if not calls():  # not a unit's: what was there before takes it when the faulty instruction is run again
            set_handler(number, _before[number])
            if number == signal.SIGABRT:
                signal.raise_signal(number)
            return
        signal.alarm(PATIENCE)
        name = signal.Signals(number).name
        leave(f"crashed in {under_way()}", f"{name}: {_FAULTS[name]}")

    handler = ctypes.CFUNCTYPE(None, ctypes.c_int)(fault)
    _armed.append(handler)
    for number in (getattr(signal, name) for name in _FAULTS):
        before = set_handler(number, ctypes.cast(handler, ctypes.c_void_p))
        if before is None or faulthandler.is_enabled():  # the default action, or a traceback
            _before[number] = before
        else:
            set_handler(number, before)
    atexit.register(lambda: [set_handler(number, before) for number, before in _before.items()])


def _exits(_: object) -> None:
    if calls():
        leave(f"ended the process in {under_way()}", "its library called exit")


def calls() -> list[Call]:
    """Those under way: more than one where several threads make them."""
    if current is None:
        return []
    return current() if callable(current) else [current]


def under_way() -> str:
    """The function, and the time at which it is to begin a step."""
    _, function, arguments = calls()[0]
    name = getattr(function, "__name__", str(function))
    return f"{name} at t = {arguments[0]:.9g} s" if name == "doStep" and arguments else name


def leave(what: str, how: str, code: int = CODE) -> None:
    """Says so in pieces that need no memory of the C library, which may be broken, and leaves."""
    names = " or ".join(f"'{name}'" for name, *_ in calls())
    with suppress(OSError):
        os.write(2, f"phfmu: the unit {names} {what} ({how}).".encode())
        os.write(2, b" Next: --isolate gives it a process of its own, and keeps the rows and the audit until then")
        os.write(2, f"{'; of this run ' if left else ''}{', '.join(left)}\n".encode())
        if faulthandler.is_enabled():
            faulthandler.dump_traceback()
        sys.stdout.flush()
    os._exit(code)
