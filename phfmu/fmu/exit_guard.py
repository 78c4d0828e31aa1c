"""A unit that ends the process (`exit` in its library) does not do so unnoticed.

While a call into a unit is under way its name stands here.  A handler that the C library runs on `exit` finds it, says which
unit ended the process and in which call, and leaves with exit code 3.  Handlers of a library handle of our own can be
taken back (`__cxa_finalize`), which is done before the interpreter ends, so none of it runs on an ordinary exit.
Only where the C library can do this: glibc and macOS.  `_exit` and signals end the process without any handler.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
from typing import Any

#: exit code of a run that did not reach its end
CODE = 3

#: name of the unit and function of the call that is under way; between calls there is none
current: tuple[str, Any] | None = None

_armed: list[Any] = []  # what must not be collected while the C library may call it


def arm() -> None:
    """Once a process; nothing where the C library cannot take handlers back."""
    if _armed or not _can_take_back():
        return
    library = ctypes.CDLL(None)
    handle = ctypes.c_char()
    handler = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_leave)
    _armed.extend((library, handle, handler))
    library.__cxa_atexit(handler, None, ctypes.byref(handle))
    atexit.register(_take_back)


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


def _take_back() -> None:
    """Runs the handler, which finds no call, and forgets it."""
    library, handle, _ = _armed
    library.__cxa_finalize(ctypes.byref(handle))


def _leave(_: object) -> None:
    if current is None:
        return
    unit, function = current
    call = getattr(function, "__name__", function)
    print(
        f"phfmu: the unit '{unit}' ended the process in {call} (its library called exit); the run is not finished: rows are "
        "in the .partial file of -o, `phfmu audit recover` reads an audit",
        file=sys.stderr,
        flush=True,
    )
    try:
        sys.stdout.flush()
    finally:
        os._exit(CODE)
