"""Signals that end what is going on: Ctrl-C, SIGTERM and the end of the terminal are heard wherever the time is spent.

Outside of runs such a signal raises at once (`raising`).  A run keeps the first one (`DeferredInterrupt`) until it is between
two blocks of steps, so that nothing of it is lost; what else may take long on the way, a compiler or a unit in a process of its
own, asks for it (`check`).  Waits that a handler cannot end are taken in slices of `SLICE` s; where other people's code clears
the error that a signal raised within it, as conversions of arguments do, it is raised again every `AGAIN` s until something ends
by it.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

#: Ctrl-C, the end asked for by another process, the end of the terminal
NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
#: s
SLICE = 0.2
AGAIN = 0.5


class Interrupted(KeyboardInterrupt):
    """A signal ended the run; `number` is the signal's, `recorded` what was taken before by the call that it ended."""

    def __init__(self, number: int):
        super().__init__(signal.Signals(number).name)
        self.number = number
        self.recorded: dict[str, Any] = {}


class DeferredInterrupt:
    """Keeps the first signal for `check` while entered; a second one ends the run wherever it is.

    A signal that is ignored (nohup) stays so; outside the main thread nothing changes.
    """

    def __init__(self) -> None:
        self._number: int | None = None
        self._before: dict[int, Any] = {}
        self._outer: DeferredInterrupt | None = None

    def __enter__(self) -> DeferredInterrupt:
        global _current
        self._outer, _current = _current, self
        self._before = _handled(self._take, NAMES)
        return self

    def __exit__(self, *_: object) -> None:
        global _current
        _current = self._outer
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def check(self) -> None:
        """Raise Interrupted if a signal came."""
        if self._number is not None:
            raise Interrupted(self._number)

    def _take(self, number: int, _: object) -> None:
        if self._number is not None:
            raise Interrupted(number)
        self._number = number


_current: DeferredInterrupt | None = None


def check() -> None:
    """Raise Interrupted in the main thread if a signal came that is kept: for waits that lose nothing of accepted steps."""
    if _current is not None and threading.current_thread() is threading.main_thread():
        _current.check()


@contextmanager
def raising() -> Iterator[None]:
    """Let the signals raise Interrupted, where nobody else has taken them."""
    alarm = hasattr(signal, "setitimer")

    def take(number: int, _: object) -> None:
        def again(*_: object) -> None:
            if not _ending():
                raise Interrupted(number)

        if alarm:
            before.setdefault(signal.SIGALRM, signal.signal(signal.SIGALRM, again))
            signal.setitimer(signal.ITIMER_REAL, AGAIN, AGAIN)
        raise Interrupted(number)

    before = _handled(take, NAMES, only=(signal.SIG_DFL, signal.default_int_handler))
    try:
        yield
    finally:
        if alarm and signal.SIGALRM in before:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def _ending() -> bool:
    """Whether what runs is on its way out by such a signal: an error of it is being handled."""
    error = sys.exc_info()[1]
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def _handled(take: Any, names: Any, only: tuple[Any, ...] = ()) -> dict[int, Any]:
    """Handlers that `take` took the place of: not of ignored signals, nor, if given, where another than `only` is set."""
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in (getattr(signal, name) for name in names if hasattr(signal, name)):
            known = signal.getsignal(number)
            if known is not signal.SIG_IGN and (not only or known in only):
                before[number] = signal.signal(number, take)
    return before
