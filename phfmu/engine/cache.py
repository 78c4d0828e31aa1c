"""Compiled libraries kept from run to run: lib/KEY/SHA256.so, whose name says what its content must be.

A library that was cut off or changed on the disk would end the process that loads it (SIGBUS), so it is never
loaded. A folder in which others can put files is not used at all: what is loaded from it runs as the user.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path


def cache_folder() -> Path:
    """PHFMU_CACHE_DIR, else the user cache folder of the platform / phfmu. Not created here."""
    if chosen := os.environ.get("PHFMU_CACHE_DIR"):
        return Path(chosen).absolute()
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "phfmu"


def find(key: str, ending: str) -> Path | None:
    """The sound library that was put under `key`; damaged ones are removed."""
    folder = cache_folder()
    for root in (_private(folder), folder) if folder in _refused else (folder,):
        if _distrust(root) is None:
            for path in _sound(root / "lib" / key, ending):
                return path
    return None


def _sound(folder: Path, ending: str) -> Iterator[Path]:
    with suppress(OSError):
        for path in sorted(folder.glob(f"*{ending}")):
            if hashlib.sha256(path.read_bytes()).hexdigest() == path.stem:
                yield path
            else:
                path.unlink()


def put(root: Path, key: str, library: Path) -> Path:
    """Move a library of the same file system to its place; whole or not at all, also beside others that do the same."""
    path = root / "lib" / key / f"{hashlib.sha256(library.read_bytes()).hexdigest()}{library.suffix}"
    path.parent.mkdir(mode=0o700, exist_ok=True)
    try:
        os.replace(library, path)
    except PermissionError:  # Windows: another process has the same library loaded
        if not path.exists():
            raise
    return path


def writable() -> Path:
    """A folder to build in, with a subfolder `lib`: the cache, else a private one that ends with the process."""
    folder = cache_folder()
    if folder in _refused:
        return _private(folder)
    reason = _distrust(folder)
    if reason is None:
        try:
            for made in (folder, folder / "lib"):
                made.mkdir(mode=0o700, parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder / "lib"):
                return folder
        except OSError as error:
            reason = f"it cannot be written ({error.strerror})"
    _refused.add(folder)
    print(
        f"phfmu: the cache {folder} is not used: {reason}; building in a temporary folder (PHFMU_CACHE_DIR names another)",
        file=sys.stderr,
    )
    return _private(folder)


#: caches that could not be used by this process
_refused: set[Path] = set()


@cache
def _private(_: Path) -> Path:
    """The private folder used instead of a cache."""
    folder = Path(tempfile.mkdtemp(prefix="phfmu-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    (folder / "lib").mkdir()
    return folder


def _distrust(folder: Path) -> str | None:
    """Why others could put files there, if they could."""
    if not hasattr(os, "geteuid"):
        return None
    for part in (folder, folder / "lib"):
        try:
            found = part.stat()
        except OSError:
            return None
        if found.st_uid not in (os.geteuid(), 0):
            return f"{part} belongs to another user (uid {found.st_uid})"
        if found.st_mode & 0o002:
            return f"anybody can write to {part}"
    return None
