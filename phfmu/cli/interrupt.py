"""Signals that end a run: it stops between two blocks of steps, so that nothing of it is lost."""

from __future__ import annotations

import signal
import threading
from typing import Any

#: Ctrl-C, the end asked for by another process, the end of the terminal
NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


class Interrupted(KeyboardInterrupt):
    """A signal ended the run; `number` is the signal's."""

    def __init__(self, number: int):
        super().__init__(signal.Signals(number).name)
        self.number = number


class Signals:
    """While entered, the first signal is kept for `check`; a second one ends the run wherever it is.

    A signal that is ignored (nohup) stays so; outside the main thread nothing changes.
    """

    def __init__(self) -> None:
        self._number: int | None = None
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Signals:
        if threading.current_thread() is threading.main_thread():
            for number in (getattr(signal, name) for name in NAMES if hasattr(signal, name)):
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._take)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def check(self) -> None:
        """Interrupted if a signal came."""
        if self._number is not None:
            raise Interrupted(self._number)

    def _take(self, number: int, _: object) -> None:
        if self._number is not None:
            raise Interrupted(number)
        self._number = number
