"""How far long work has come: told on a terminal, nothing in a pipe."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from typing import Any


class Bar(ExitStack):
    """A bar for work of `total`, called with how much is done; `quiet`: none."""

    def __init__(self, what: str, total: float, quiet: bool = False):
        super().__init__()
        self._bar: Any = None
        if sys.stderr.isatty() and not quiet:
            from rich.console import Console
            from rich.progress import Progress

            self._bar = self.enter_context(Progress(console=Console(stderr=True), transient=True))
            self._task = self._bar.add_task(what, total=total)

    def __call__(self, done: float) -> None:
        if self._bar is not None:
            self._bar.update(self._task, completed=done)


class Line:
    """One line that says what is at work; gone at the end."""

    def __enter__(self) -> Line:
        self._show = sys.stderr.isatty()
        return self

    def __call__(self, text: str) -> None:
        if self._show:
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)

    def __exit__(self, *_: object) -> None:
        self("")
