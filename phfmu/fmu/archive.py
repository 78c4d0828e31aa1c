"""Opening an archive: names and sizes are checked first, then only what is needed is extracted."""

from __future__ import annotations

import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from weakref import WeakValueDictionary

import fmpy

from phfmu.fmu.interface import Interface, read_interface
from phfmu.fmu.manifest import PATH as MANIFEST
from phfmu.fmu.variables import FMUError

#: refuse what would fill the disk
LARGEST = 4 * 2**30


class Archive:
    """An extracted unit: its `interface`, and the folder that lives as long as this object."""

    def __init__(self, path: Path):
        self.path = path
        try:
            with zipfile.ZipFile(path) as archive:
                names = _checked(archive, path)
                _require(names, path)
                self.interface = read_interface(
                    archive.read("modelDescription.xml"),
                    archive.read(MANIFEST) if MANIFEST in names else None,
                    path.name,
                )
                self.library = _library(names, self.interface, path)
                self._folder = tempfile.TemporaryDirectory(prefix="phfmu-")
                archive.extractall(self._folder.name, [n for n in names if _needed(n, self.library)])
        except FileNotFoundError:
            raise FMUError(f"{path}: there is no such file") from None
        except (
            zipfile.BadZipFile,
            zlib.error,
            EOFError,
            NotImplementedError,
            RuntimeError,
            OSError,
        ) as error:
            if isinstance(error, FMUError):
                raise
            raise FMUError(f"{path}: not a readable archive ({error}); export or download it again") from error
        self.folder = Path(self._folder.name)
        (self.folder / "resources").mkdir(exist_ok=True)


_OPEN: WeakValueDictionary[tuple[str, int, int], Archive] = WeakValueDictionary()


def open_archive(path: str | Path) -> Archive:
    """The extracted unit, shared by the instances of a file while one of them lives.  FMUError if refused."""
    path = Path(path)
    try:
        about = path.stat()
    except OSError:
        raise FMUError(f"{path}: there is no such file") from None
    key = (str(path.resolve()), about.st_mtime_ns, about.st_size)
    archive = _OPEN.get(key)
    if archive is None:
        archive = _OPEN[key] = Archive(path)
    return archive


def _checked(archive: zipfile.ZipFile, path: Path) -> list[str]:
    """Names of the files; refuses names that leave the folder, links, and sizes beyond all reason."""
    total = 0
    for entry in archive.infolist():
        name, parts = entry.orig_filename, PurePosixPath(entry.filename).parts
        if ".." in parts or name.startswith("/") or "\\" in name or ":" in name or "\0" in name:
            raise FMUError(f"{path}: the archive holds the path '{name}', which leaves its folder; refused")
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise FMUError(f"{path}: the archive holds the link '{name}'; refused")
        total += entry.file_size
    if total > LARGEST:
        raise FMUError(f"{path}: {total} bytes when extracted, more than {LARGEST}; refused")
    return [e.filename for e in archive.infolist() if not e.is_dir()]


def _require(names: Iterable[str], path: Path) -> None:
    if "modelDescription.xml" not in names:
        raise FMUError(f"{path}: the archive has no modelDescription.xml, so it is no FMU")


def _library(names: list[str], interface: Interface, path: Path) -> str:
    """Name inside of the library for this machine."""
    folders = (fmpy.platform, fmpy.platform_tuple) if interface.version == "2.0" else (fmpy.platform_tuple,)
    for folder in folders:
        name = f"binaries/{folder}/{interface.identifier}{fmpy.sharedLibraryExtension}"
        if name in names:
            return name
    found = sorted({PurePosixPath(n).parts[1] for n in names if n.startswith("binaries/") and n.count("/") > 1})
    raise FMUError(
        f"{path}: no library for this platform ({' or '.join(folders)}); the archive has "
        f"{', '.join(found) if found else 'none'}. Export it with this platform"
    )


def _needed(name: str, library: str) -> bool:
    """Libraries of other platforms, sources and documentation stay in the archive."""
    if name.startswith("binaries/"):
        return PurePosixPath(name).parent == PurePosixPath(library).parent
    return not name.startswith(("sources/", "documentation/"))
