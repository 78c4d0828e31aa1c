"""Progress of long work: told on a terminal, nothing in a pipe; and before a very long run, what is coming, anywhere."""

from __future__ import annotations

import shutil
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.runs.options import Options

#: a run of so many steps is told of before it starts
LONG = 10_000_000
#: bytes of a number in a table, by its ending, as measured on tables of runs
BYTES = {".csv": 16, ".parquet": 7}


class ProgressBar(ExitStack):
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


class StatusLine:
    """Line of a terminal that says what is at work; it is gone at the end."""

    def __enter__(self) -> StatusLine:
        self._show = sys.stderr.isatty()
        return self

    def __call__(self, text: str) -> None:
        if self._show:
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)

    def __exit__(self, *_: object) -> None:
        self("")


def ahead(options: Options, columns: int, table: Path | None) -> list[str]:
    """Lines about what a run of equal steps with so many columns takes and writes, where that is very much or next to nothing."""
    if options.adaptive:
        return []
    length = options.stop - options.t0
    steps, apart = length / options.step, options.every
    rows = steps * (1 if options.dense is None else options.dense + 1)
    if apart is not None:
        rows = min(rows, rows / apart if isinstance(apart, int) else length / apart)
    lines = []
    if apart is not None and rows < 1 and table is not None:
        lines.append(
            f"--every {apart:g}: no such row within the run of {steps:.3g} steps; its first and its last are kept"
        )
    if steps >= LONG or (rows >= LONG and table is not None):
        lines.append(f"{steps:.3g} steps to come" + (_written(rows, columns + 1, table) if table is not None else ""))
    return lines


def _written(rows: float, columns: int, table: Path) -> str:
    size, free = rows * columns * BYTES[table.suffix], shutil.disk_usage(table.parent).free
    text = (
        f"; {table.name}: {rows:.3g} rows of {columns} columns, about {_bytes(size)}, of {_bytes(free)} that are free"
    )
    return text if rows < LONG else f"{text} (--every N keeps every Nth row, --signals some columns)"


def _bytes(size: float) -> str:
    """1500000 -> 1.5 MB."""
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} PB"
