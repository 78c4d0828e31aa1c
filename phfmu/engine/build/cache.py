"""Compiled libraries kept from run to run: lib/KEY/SHA256.so, whose name holds the hash of its content.

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

from phfmu.engine.build import trust

#: bytes without which nothing can be built
ROOM = 1 << 20


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


class CacheFull(OSError):
    """There is no room left in the folder of a cache."""


def find(key: str, ending: str) -> Path | None:
    """The sound library that was put under `key`; damaged ones are removed."""
    folder = cache_folder()
    for root in (_private(folder), folder) if folder in _refused else (folder,):
        if trust.distrust(root, root / "lib", root / "lib" / key) is None:
            for path in _sound(root / "lib" / key, ending):
                return path
    return None


def whole(folder: Path, ending: str) -> Path | None:
    """The library of a folder outside the cache whose content has the hash in its name."""
    return next(filter(_is_whole, folder.glob(f"*{ending}")), None)


def _is_whole(path: Path) -> bool:
    return hashlib.sha256(path.read_bytes()).hexdigest() == path.stem


def _sound(folder: Path, ending: str) -> Iterator[Path]:
    with suppress(OSError):
        for path in sorted(folder.glob(f"*{ending}")):
            if trust.distrust_one(path) is None and _is_whole(path):
                yield path
            else:
                path.unlink()


def put(root: Path, key: str, library: Path) -> Path:
    """Move a library of the same file system to its place; whole or not at all, also beside others that do the same."""
    path = root / "lib" / key / f"{hashlib.sha256(library.read_bytes()).hexdigest()}{library.suffix}"
    path.parent.mkdir(mode=0o700, exist_ok=True)
    with suppress(OSError):
        path.parent.chmod(0o700)  # what others put there before is not theirs to change any more, and not taken
    library.chmod(0o755)  # also where the umask lets others write to new files
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
    reason = trust.distrust(folder, folder / "lib")
    if reason is None:
        try:
            for made in (folder, folder / "lib"):
                made.mkdir(mode=0o700, parents=True, exist_ok=True)
            require_room(folder, 1)
            return folder
        except OSError as error:
            reason = f"it cannot be written ({error.strerror})"
    return refused(folder, reason)


def require_room(root: Path, size: int = ROOM) -> None:
    """CacheFull where so many bytes cannot be written; those without which nothing is built, after something was not."""
    try:
        with tempfile.TemporaryFile(dir=root / "lib") as f:
            f.write(bytes(size))
    except OSError as error:
        raise CacheFull(error.errno, error.strerror, str(root)) from error


def refused(folder: Path, reason: str) -> Path:
    """Says why the cache is not used from now on; the private folder used instead."""
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
