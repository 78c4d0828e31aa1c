"""A unit that ends the process (`exit` in its library, a crash) does not do so unnoticed.

While a call into a unit is under way its name stands here.  A handler that the C library runs on `exit`, and one for signals
that a fault raises, find it, say which unit ended the process, in which call and how, and leave with exit code 3.
Handlers of `exit` are taken back (`__cxa_finalize`) before the interpreter ends, so none of it runs on an ordinary
end; only glibc and macOS can do that.  Of a signal, a handler that something else has set (another language's runtime)
stays; that of faulthandler still prints its traceback.  They have a stack of their own, since that of the unit may be exhausted.
`_exit` runs no handler, so calls of it are led here (`imported_exit.py`, Linux).  SIGKILL leaves no time for anything.
"""

from __future__ import annotations

import atexit
import ctypes
import faulthandler
import os
import signal
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

from phfmu.fmu.isolation import imported_exit

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
    "SIGSEGV": "it used memory that is not its own, or all of its stack",
    "SIGBUS": "it used memory that is not there",
    "SIGFPE": "a fault in arithmetic",
    "SIGILL": "an instruction that this machine does not have",
    "SIGABRT": "its library called abort, or an assertion failed",
}

#: units that live, or have lived, in this process
units: dict[str, None] = {}

#: bytes of the stack of the handlers, which run the interpreter
STACK = 2**20

_armed: list[Any] = []  # what must not be collected while the C library may call it
_alone: list[bool] = []  # whether this process is a unit's own
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
    _alone.append(True)


def watch(library: ctypes.CDLL, unit: str) -> None:
    """A library that has been loaded for a unit."""
    units[unit] = None
    if not _alone:
        imported_exit.lead(library, _at_once)


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
        if not calls() and units and number == signal.SIGFPE:  # nothing else asks for floating-point exceptions
            told = "switched on floating-point exceptions, of which one was met between its calls"
            leave(told, "SIGFPE: a fault in arithmetic", names=units)
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
            _on_own_stack(library, number)
        else:
            set_handler(number, before)
    atexit.register(lambda: [set_handler(number, before) for number, before in _before.items()])


class _LinuxAction(ctypes.Structure):
    _fields_ = [
        ("handler", ctypes.c_void_p),
        ("mask", ctypes.c_uint64 * 16),
        ("flags", ctypes.c_int),
        ("restorer", ctypes.c_void_p),
    ]


class _LinuxStack(ctypes.Structure):
    _fields_ = [("start", ctypes.c_void_p), ("flags", ctypes.c_int), ("size", ctypes.c_size_t)]


def _on_own_stack(library: ctypes.CDLL, number: int) -> None:
    """The handler of a signal runs on another stack than the code that raised it (Linux)."""
    if sys.platform != "linux" or sys.version_info >= (3, 14):  # which takes another stack for an exhausted one
        return
    if not any(isinstance(held, ctypes.Array) for held in _armed):
        memory = (ctypes.c_char * STACK)()
        _armed.append(memory)
        library.sigaltstack(ctypes.byref(_LinuxStack(ctypes.addressof(memory), 0, STACK)), None)
    action = _LinuxAction()
    library.sigaction(number, None, ctypes.byref(action))
    action.flags |= 0x08000000  # SA_ONSTACK
    library.sigaction(number, ctypes.byref(action), None)


def _exits(_: object) -> None:
    if calls():
        leave(f"ended the process in {under_way()}", "its library called exit")


def _exits_at_once(code: int) -> None:
    """The function that stands in place of `_exit`."""
    if calls():
        leave(f"ended the process in {under_way()}", "its library called _exit")
    os._exit(code)


_at_once = ctypes.CFUNCTYPE(None, ctypes.c_int)(_exits_at_once)


def calls() -> list[Call]:
    """Calls under way: more than one where several threads make them."""
    if current is None:
        return []
    return current() if callable(current) else [current]


def under_way() -> str:
    """The function, and the time at which it is to begin a step."""
    _, function, arguments = calls()[0]
    name = getattr(function, "__name__", str(function))
    return f"{name} at t = {arguments[0]:.9g} s" if name == "doStep" and arguments else name


def leave(what: str, how: str, code: int = CODE, names: Iterable[str] = ()) -> None:
    """Says so in pieces that need no memory of the C library, which may be broken, and leaves.  `names`: else those of calls."""
    said = " or ".join(f"'{name}'" for name in dict.fromkeys(names or (name for name, *_ in calls())))
    with suppress(OSError):
        os.write(2, f"phfmu: the unit {said} {what} ({how}).".encode())
        os.write(2, b" Next: --isolate gives it a process of its own, and keeps the rows and the audit until then")
        os.write(2, f"{'; of this run ' if left else ''}{', '.join(left)}\n".encode())
        if faulthandler.is_enabled():
            faulthandler.dump_traceback()
        sys.stdout.flush()
    os._exit(code)
