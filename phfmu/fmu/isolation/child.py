"""A process of its own for code of a unit: what it is asked, what it answers in time, what it prints, and how it ends."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Any

import phfmu
from phfmu import interrupt
from phfmu.fmu.isolation.unit_process import read, write

#: s that a process is given to end by itself
PATIENCE = 1.0
_START = "import sys; sys.path.insert(0, sys.argv[1]); from {module} import serve; serve()"


class ProcessEnded(Exception):
    """The process is not there any more; the text says how it ended."""


class AnswerTimeout(Exception):
    """There was no answer in time."""


class Child:
    """A process that runs `serve()` of a module of this package; messages are those of `unit_process`.

    `printed`: called with each line that it prints, in a thread.  `folder`, `environment`: where it runs, and variables besides
    those of this process.
    """

    def __init__(
        self,
        module: str,
        printed: Callable[[bytes], None],
        folder: str | None = None,
        environment: dict[str, str] | None = None,
    ):
        self._printed = printed
        self._process: Any = subprocess.Popen(
            [sys.executable, "-c", _START.format(module=module), str(Path(phfmu.__file__).parent.parent)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            start_new_session=True, cwd=folder, env={**os.environ, **(environment or {})},
        )  # fmt: skip
        self._answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._listen, self._pass_on)]
        for thread in self._threads:
            thread.start()

    def _listen(self) -> None:
        """Answers as they come; None at their end."""
        try:
            while (message := read(self._process.stdout)) is not None:
                self._answers.put(message)
        except (ValueError, OSError, json.JSONDecodeError):
            pass
        self._answers.put(None)

    def _pass_on(self) -> None:
        for line in self._process.stderr:
            self._printed(line)

    def tell(self, message: Any) -> None:
        """A message to it; Lost if it is not there."""
        try:
            write(self._process.stdin, message)
        except (OSError, ValueError):
            raise ProcessEnded(self._end()) from None

    def answer(self, timeout: float) -> Any:
        """Its next answer; Late if there is none in so many s, Lost if it ended, Interrupted if a signal comes before."""
        try:
            found = self._awaited(timeout)
        except queue.Empty:
            raise AnswerTimeout() from None
        if found is None:
            raise ProcessEnded(self._end())
        return found

    def _awaited(self, timeout: float) -> Any:
        late = monotonic() + timeout
        while (left := late - monotonic()) > interrupt.SLICE:
            try:
                return self._answers.get(timeout=interrupt.SLICE)
            except queue.Empty:
                interrupt.check()
        return self._answers.get(timeout=max(left, 0.0))

    def _end(self) -> str:
        """The end of the process in words: exit code or signal."""
        try:
            code = self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            return "its process closed the connection"
        if code >= 0:
            return f"its process ended with exit code {code}"
        names = {s.value: s.name for s in signal.Signals}
        return f"its process was ended by {names.get(-code, f'signal {-code}')}"

    def kill(self) -> None:
        """End it now; all that it printed has been passed on afterwards."""
        self._process.kill()
        self._process.wait()
        self._threads[1].join(PATIENCE)

    def close(self) -> None:
        """No more messages: it ends by itself, or is ended."""
        self._process.stdin.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for thread in self._threads:
            thread.join(PATIENCE)
        self._process.stdout.close()
        self._process.stderr.close()
