"""Files that others see only when they are whole."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

ENDING = ".partial"
#: ends of the names of files that are grids
GRIDS = (".raw", ".m")

_folder: ContextVar[Path | None] = ContextVar("_folder", default=None)


@contextmanager
def seen_from(folder: Path) -> Iterator[None]:
    """Within the block, files that others name are also looked for in this folder."""
    token = _folder.set(folder)
    try:
        yield
    finally:
        _folder.reset(token)


def located(path: Path) -> Path:
    """The path as it is where a file is there, else where it is seen from."""
    folder = _folder.get()
    return path if folder is None or path.exists() else folder / path


def beside(target: Path) -> Path:
    """A new empty file in the folder of `target`, under a name that cannot be foretold: to be written, then moved there.

    It has the permissions of any new file (by the umask). Errors: OSError if the folder cannot be written.
    """
    while True:
        path = target.with_name(f"{target.name}.{secrets.token_hex(4)}{ENDING}")
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        except FileExistsError:
            continue
        return path


def remains(target: Path) -> list[Path]:
    """Files for `target` that were never moved there, the last written first."""
    with suppress(OSError, ValueError):  # no such folder; no name of a folder
        found = [p for p in target.parent.iterdir() if p.name.startswith(f"{target.name}.") and p.suffix == ENDING]
        return sorted(found, key=lambda p: p.stat().st_mtime, reverse=True)
    return []


def require_writable(target: Path, shown: str) -> None:
    """Raise ValueError unless a file can be put at `target`: asked before long work, not after it. `shown`: what to call it."""
    folder = target.parent
    if not folder.is_dir():
        raise ValueError(f"{shown}: there is no folder '{folder}'; make it first")
    if target.is_dir():
        raise ValueError(f"{shown} is a folder; name a file")
    if target.exists() and not (target.is_file() and os.access(target, os.W_OK)):
        raise ValueError(f"{shown} is there and may not be replaced; name another file")
    try:
        beside(target).unlink()
    except OSError as error:
        raise ValueError(f"{shown}: cannot write in the folder '{folder}': {error.strerror}") from error


def require_folder(folder: Path, shown: str, what: str) -> None:
    """Raise ValueError unless files can be put into `folder`, which may have to be made; `what`: the files, in words."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{shown} is a file; name a folder for {what}")
    above = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    try:
        beside(above / "x").unlink()
    except OSError as error:
        raise ValueError(f"{shown}: cannot write in the folder '{above}': {error.strerror}") from error
