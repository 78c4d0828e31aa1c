"""Places of the files of a structure: in an archive (.ssp), or beside a description (.ssd)."""

from __future__ import annotations

import atexit
import posixpath
import shutil
import tempfile
from pathlib import Path
from typing import Protocol
from urllib.parse import unquote, urlsplit

from phfmu.fmu import limits
from phfmu.fmu.importer import archive
from phfmu.fmu.importer.ports.port_tables import ENDING
from phfmu.fmu.words import plain
from phfmu.ssp.names import STRUCTURE
from phfmu.ssp.structure import SSPError
from phfmu.words import meant


class Package(Protocol):
    """`structure`: name of the description; others by the URI that a description names them with."""

    path: Path
    structure: str

    def read(self, uri: str) -> bytes:
        """Content of a document.  SSPError, FMUError: it is not there, leaves the package, or is too long."""
        ...

    def file(self, uri: str) -> Path:
        """A file to be opened by its path, which exists until the end of the process."""
        ...


def open_package(path: str | Path) -> Package:
    """The package of a .ssp or .ssd.  SSPError, FMUError if it cannot be read."""
    path = Path(path)
    if not path.is_file():
        raise SSPError(f"{path}: there is no such file")
    return _Folder(path) if path.suffix.lower() == ".ssd" else _Archive(path)


class Within:
    """A description in a folder of a package: paths are seen from there."""

    def __init__(self, package: Package, uri: str):
        self.path, self._package = package.path, package
        self._folder, _, self.structure = uri.rpartition("/")

    def read(self, uri: str) -> bytes:
        return self._package.read(self._seen(uri))

    def file(self, uri: str) -> Path:
        return self._package.file(self._seen(uri))

    def _seen(self, uri: str) -> str:
        _local(self.path, uri)
        return f"{self._folder}/{uri}" if self._folder else uri


def inside(file: Path, uri: str) -> bytes:
    """A document inside a unit.  SSPError, FMUError: it is not there, or is too long."""
    with archive.opened(file) as content:
        names = archive.checked(content, file)
        name = posixpath.normpath(_local(file, uri))
        if name not in names:
            raise SSPError(f"{file.name} has no file '{plain(uri, 200)}'; {meant(name, sorted(names))}")
        return archive.document(content, name, file)


def _local(path: Path, uri: str) -> str:
    """The relative path that a URI names."""
    parts = urlsplit(uri)
    if parts.scheme or parts.netloc or parts.query or "\\" in uri or "\0" in uri or uri.startswith("/"):
        raise SSPError(f"{path}: '{plain(uri, 200)}' is not the relative path of a file; put the file into the package")
    return unquote(parts.path)


class _Folder:
    """A description by itself: paths are seen from its folder."""

    def __init__(self, path: Path):
        self.path, self.structure = path, path.name

    def read(self, uri: str) -> bytes:
        file = self.file(uri)
        limits.within(file, file.stat().st_size, limits.DOCUMENT, "bytes of XML")
        return file.read_bytes()

    def file(self, uri: str) -> Path:
        file = self.path.parent / _local(self.path, uri)
        if not file.is_file():
            raise SSPError(f"{self.path}: it names '{plain(uri, 200)}', but there is no file {file}")
        return file


class _Archive:
    """A zip archive; its entries are checked when it is opened, files are extracted when they are asked for."""

    structure = STRUCTURE

    def __init__(self, path: Path):
        self.path = path
        with archive.opened(path) as content:
            self._names = archive.checked(content, path)
        if STRUCTURE not in self._names:
            raise SSPError(f"{path}: the archive has no {STRUCTURE}, so it is no package of SSP")
        self._folder: Path | None = None

    def _name(self, uri: str) -> str:
        name = posixpath.normpath(_local(self.path, uri))
        if name.startswith(".."):
            raise SSPError(f"{self.path}: '{plain(uri, 200)}' leaves the archive; refused")
        if name not in self._names:
            raise SSPError(
                f"{self.path}: it names '{plain(uri, 200)}', which is not in it; {meant(name, sorted(self._names))}"
            )
        return name

    def read(self, uri: str) -> bytes:
        name = self._name(uri)
        with archive.opened(self.path) as content:
            return archive.document(content, name, self.path)

    def file(self, uri: str) -> Path:
        name = self._name(uri)
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="phfmu-"))
            atexit.register(shutil.rmtree, self._folder, ignore_errors=True)
        beside = posixpath.splitext(name)[0] + ENDING  # tells the ports of a unit
        with archive.opened(self.path) as content:
            for wanted in (name, beside):
                if wanted in self._names and not (self._folder / wanted).exists():
                    archive.extract(content, wanted, self._folder / wanted)
        return self._folder / name
