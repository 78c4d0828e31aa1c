"""Opening an archive: names and sizes are checked first; files are extracted when a library is to be loaded."""

from __future__ import annotations

import shutil
import stat
import tempfile
import zipfile
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from io import BufferedReader, FileIO
from pathlib import Path, PurePosixPath
from weakref import WeakValueDictionary, finalize

import fmpy

from phfmu.fmu import limits
from phfmu.fmu.export.manifest import PATH as MANIFEST
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.model_description import read_interface
from phfmu.fmu.importer.unit_interface import UnitInterface
from phfmu.fmu.version import VERSIONS
from phfmu.fmu.words import plain

CHUNK = 2**20
TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
#: what the standard allows; of other methods a few bytes can become gigabytes in one call
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


@dataclass(frozen=True)
class ExtractedUnit:
    """The extracted files of a unit: the folder that they are in, and the name of the library there."""

    path: Path
    folder: Path
    library: str
    interface: UnitInterface


class Archive:
    """A unit that has been read: its `interface`, and `platforms` it has libraries for."""

    def __init__(self, path: Path):
        self.path = path
        with opened(path) as archive:
            self._names = checked(archive, path)
            if "modelDescription.xml" not in self._names:
                raise FMUError(f"{path}: the archive has no modelDescription.xml, so it is no FMU")
            with archive.open("modelDescription.xml") as description:
                manifest = document(archive, MANIFEST, path) if MANIFEST in self._names else None
                self.interface: UnitInterface = read_interface(description, manifest, path.name)
        parts = [PurePosixPath(n).parts for n in self._names]
        self.platforms = tuple(sorted({plain(p[1], 50) for p in parts if p[0] == "binaries" and len(p) > 2}))

    def library_for(self, platform: str, extension: str) -> str | None:
        """Name inside of the library for a platform, whose libraries end with `extension`; None if there is none."""
        folders = VERSIONS[self.interface.version].folders_of(platform)
        names = (f"binaries/{folder}/{self.interface.identifier}{extension}" for folder in folders)
        return next((n for n in names if n in self._names), None)

    @cached_property
    def library(self) -> str:
        """Name inside of the library for this machine; FMUError names the platforms there are."""
        if name := self.library_for(fmpy.platform_tuple, fmpy.sharedLibraryExtension):
            return name
        folders = VERSIONS[self.interface.version].folders_of(fmpy.platform_tuple)
        self._require_named(folders)
        there = f"the archive has {', '.join(self.platforms) or 'none'}"
        remedy = "Export it with this platform" + (", or run it on one of those" if self.platforms else "")
        if any(n.startswith("sources/") for n in self._names):
            there, remedy = f"{there}, and sources", f"Build them with `fmpy compile {self.path.name}`, or export it"
        raise FMUError(f"{self.path}: no library for this platform ({' or '.join(folders)}); {there}. {remedy}")

    def _require_named(self, folders: Sequence[str]) -> None:
        """FMUError for libraries of this machine that are not called by the modelIdentifier."""
        end = fmpy.sharedLibraryExtension
        found = [n for n in sorted(self._names) for f in folders if n.startswith(f"binaries/{f}/") and n.endswith(end)]
        if found:
            raise FMUError(
                f"{self.path}: its modelIdentifier is '{self.interface.identifier}', so its library would be "
                f"{PurePosixPath(found[0]).parent}/{self.interface.identifier}{end}; there is {plain(', '.join(found), 200)}. "
                "Give one of them that name, or export it again"
            )

    @cached_property
    def terminals(self) -> bytes | None:
        """The document of its terminals, if it has one."""
        if TERMINALS not in self._names:
            return None
        with opened(self.path) as archive:
            return document(archive, TERMINALS, self.path)

    def contents(self, binaries: Collection[str]) -> dict[str, bytes]:
        """All files by their names, of those of `binaries/` those of these folders."""
        kept = [n for n in sorted(self._names) if not n.startswith("binaries/") or n.rpartition("/")[0] in binaries]
        with opened(self.path) as archive:
            return {n: archive.read(n) for n in kept}

    @cached_property
    def folder(self) -> Path:
        """The folder of the extracted files; it lives as long as this object."""
        wanted = [n for n in self._names if _needed(n, self.library)]
        folder = Path(tempfile.mkdtemp(prefix="phfmu-"))
        finalize(self, shutil.rmtree, folder, ignore_errors=True)
        (folder / "resources").mkdir()
        with opened(self.path) as archive:
            for name in wanted:
                extract(archive, name, folder / name)
        return folder

    @property
    def extracted(self) -> ExtractedUnit:
        """The extracted files; this object has to live as long."""
        return ExtractedUnit(self.path, self.folder, self.library, self.interface)


_OPEN: WeakValueDictionary[tuple[str, int, int], Archive] = WeakValueDictionary()


def open_archive(path: str | Path) -> Archive:
    """The unit, shared by the instances of a file while one of them lives.  FMUError if refused."""
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


class _ShortReads(BufferedReader):
    """A file whose list of entries, read in one piece, cannot be longer than the limit."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None:
            limits.within(self.name, size, limits.DIRECTORY, "bytes to be read at once, e.g. in the list of files")
        return super().read(size)


@contextmanager
def opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """The archive; what goes wrong inside is an FMUError with its path."""
    try:
        with _ShortReads(FileIO(str(path))) as file, zipfile.ZipFile(file) as archive:
            yield archive
    except FileNotFoundError:
        raise FMUError(f"{path}: there is no such file") from None
    except FMUError:
        raise
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        raise FMUError(f"{path}: not a readable archive ({error}); export or download it again") from error


def checked(archive: zipfile.ZipFile, path: Path) -> frozenset[str]:
    """Names of the files; refuses names that leave the folder, links, other packings, and sizes beyond all reason."""
    entries = archive.infolist()
    limits.within(path, len(entries), limits.ENTRIES, "files in the archive")
    for entry in entries:
        name, parts = entry.orig_filename, PurePosixPath(entry.filename).parts
        if not parts or ".." in parts or name.startswith("/") or "\\" in name or ":" in name or "\0" in name:
            raise FMUError(f"{path}: the archive holds the path '{plain(name, 200)}', which leaves its folder; refused")
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise FMUError(f"{path}: the archive holds the link '{plain(name, 200)}'; refused")
        if entry.compress_type not in METHODS:
            raise FMUError(
                f"{path}: '{plain(name, 200)}' is packed by method {entry.compress_type}; the standard allows store and "
                "deflate. Pack it again"
            )
    total = sum(e.file_size for e in entries)
    limits.within(path, total, limits.EXTRACTED, "bytes when extracted")
    packed = max(1, sum(e.compress_size for e in entries))
    if total > limits.FREE:
        limits.within(path, total // packed, limits.RATIO, "times longer when extracted than packed")
    names = [e.filename for e in entries if not e.is_dir()]
    if len(set(names)) < len(names):
        twice = next(n for n, count in Counter(names).items() if count > 1)
        raise FMUError(f"{path}: the archive holds '{plain(twice, 200)}' twice; export or pack it again")
    return frozenset(names)


def document(archive: zipfile.ZipFile, name: str, path: Path) -> bytes:
    """A short document as a whole; asked for a number of bytes, zipfile inflates no more, whatever the entry says."""
    size = archive.getinfo(name).file_size
    limits.within(f"{path}/{name}", size, limits.DOCUMENT, "bytes of XML")
    with archive.open(name) as source:
        return source.read(size)


def extract(archive: zipfile.ZipFile, name: str, target: Path) -> None:
    """One file, piece by piece; zipfile reads no more than the size that was checked."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(name) as source, open(target, "wb") as file:
        while piece := source.read(CHUNK):
            file.write(piece)


def _needed(name: str, library: str) -> bool:
    """Libraries of other platforms, sources and documentation stay in the archive."""
    if name.startswith("binaries/"):
        return PurePosixPath(name).parent == PurePosixPath(library).parent
    return not name.startswith(("sources/", "documentation/"))
