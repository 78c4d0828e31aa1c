"""C sources -> objects -> a shared library.

Objects are cached (`cache.py`) by what they are made of, so the runtime, the same for every model, is compiled once,
and so is what two libraries of one model have in common.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import re
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from phfmu import interrupt
from phfmu.engine.build import cache
from phfmu.processors import processors

INCLUDE = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*["<]([^">\n]+)[">]', re.MULTILINE)


class CompileError(RuntimeError):
    """The compiler refused the sources; the message holds its output."""


@dataclass(frozen=True)
class Toolchain:
    """A compiler with its options.  `version` stands for the program.

    `link`: options it has besides when it links, `own`: when it compiles a source, by the name of that.
    """

    program: tuple[str, ...]
    version: str
    options: tuple[str, ...]
    link: tuple[str, ...]
    own: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def key(self, files: Mapping[str, bytes], more: Sequence[str] = ()) -> str:
        """Name in the cache of the output for `files`; where the program stands does not matter."""
        digest = hashlib.sha256(repr((self.program[1:], self.version, self.options, tuple(more))).encode())
        for name in sorted(files):
            digest.update(f"\0{name}\0{len(files[name])}\0".encode() + files[name])
        return digest.hexdigest()[:32]

    def library_key(self, files: Mapping[str, bytes]) -> str:
        """Name in the cache of the library of `files`."""
        return self.key(files, (*self.link, *(f"{n}: {o}" for n in sorted(self.own) for o in self.own[n])))


def needed(name: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The file and those it includes, also by way of others; headers of the system are not among them."""
    found: dict[str, bytes] = {}
    todo = [name]
    while todo:
        if (n := todo.pop()) in files and n not in found:
            found[n] = files[n]
            todo += [m.decode() for m in INCLUDE.findall(files[n])]
    return found


def build(files: Mapping[str, bytes], tools: Toolchain, end: str, key: str) -> Path:
    """Library of all `files` that end in .c, put into the cache under `key`; where that is full, into a folder that ends with the
    process.

    Everything happens in a private folder whose results are moved into the cache whole: nobody sees half a file.
    Only relative names are told to the compiler, so that objects are the same wherever the folder is.
    """
    root = cache.writable()
    try:
        return _built(root, files, tools, end, key)
    except cache.CacheFull as full:
        if root != cache.cache_folder():
            raise
        return _built(cache.refused(root, f"it has no room ({full.strerror})"), files, tools, end, key)


def _built(root: Path, files: Mapping[str, bytes], tools: Toolchain, end: str, key: str) -> Path:
    """The library in this cache; CacheFull if there is no room.

    The end of a process may meet a compiler of a thread that still writes into the folder, which is no error then.
    """
    with tempfile.TemporaryDirectory(dir=root / "lib", ignore_cleanup_errors=True) as folder:
        try:
            return _BuildFolder(root, Path(folder), tools, files).library(end, key)
        except (OSError, CompileError):
            cache.require_room(root)
            raise


#: compilers have processes of their own, which are ended together
_APART: dict[str, Any] = {"process_group": 0} if hasattr(os, "killpg") else {}


def _end(process: subprocess.Popen[str]) -> None:
    if _APART:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()


#: all compilers at work, those of threads that the end of the process does not wait for too
_ALL: set[subprocess.Popen[str]] = set()


@atexit.register
def _end_all() -> None:
    for process in [*_ALL]:
        _end(process)


@dataclass(frozen=True)
class _BuildFolder:
    """A private folder with the sources; `root`: the cache, `running`: compilers that are at work, `over`: no more are wanted."""

    root: Path
    folder: Path
    tools: Toolchain
    files: Mapping[str, bytes]
    running: list[subprocess.Popen[str]] = field(default_factory=list)
    over: threading.Event = field(default_factory=threading.Event)

    def library(self, end: str, key: str) -> Path:
        """Path in the cache of the library that is linked from the objects."""
        for name, content in self.files.items():
            (self.folder / name).write_bytes(content)
        objects = self.objects(sorted(n for n in self.files if n.endswith(".c")))
        result = "library" + end
        self.run(*self.tools.link, *objects, "-o", result, "-lm")
        return cache.put(self.root, key, self.folder / result)

    def objects(self, names: list[str]) -> list[str]:
        """Objects of the sources, compiled side by side; a signal that ends the work ends the compilers too.

        Beside the main thread nothing waits for workers, which the end of the process would wait for.
        """
        if threading.current_thread() is not threading.main_thread() and len(names) == 1:
            return [self.object(names[0])]
        with ThreadPoolExecutor(processors()) as pool:
            try:
                longest = sorted(
                    names, key=lambda name: -len(self.files[name])
                )  # first, so that none is left over at the end
                futures = {name: pool.submit(self.object, name) for name in longest}
                while True:
                    done, waiting = wait(futures.values(), interrupt.SLICE, FIRST_EXCEPTION)
                    made = {name: f.result() for name, f in futures.items() if f in done}
                    if not waiting:
                        return [made[name] for name in names]
                    interrupt.check()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                self.over.set()  # before the list is read: a compiler that is not in it yet ends itself
                for process in [*self.running]:
                    _end(process)
                raise

    def object(self, name: str) -> str:
        """The object of one source, in the folder: from the cache, else compiled and put there."""
        options = (*self.tools.own.get(name, ()), "-c", name)
        key = self.tools.key(needed(name, self.files), options)
        result = f"{name}.o"
        if known := cache.find(key, ".o"):
            shutil.copyfile(known, self.folder / result)
        else:
            self.run(*options, "-o", result)
            copy = shutil.copyfile(self.folder / result, self.folder / f"{name}.copy.o")
            cache.put(self.root, key, Path(copy))
        return result

    def run(self, *options: str) -> None:
        """The cache of zig's own C library is kept; of what it compiles here, `cache.py` keeps enough."""
        own = {"ZIG_GLOBAL_CACHE_DIR": str(self.root / "zig"), "ZIG_LOCAL_CACHE_DIR": str(self.folder / "zig")}
        command = [*self.tools.program, *self.tools.options, *options]
        pipe = subprocess.PIPE
        with subprocess.Popen(
            command, cwd=self.folder, stdout=pipe, stderr=pipe, text=True, env=os.environ | own, **_APART
        ) as process:
            self.running.append(process)
            _ALL.add(process)
            try:
                if self.over.is_set():
                    _end(process)
                _, said = process.communicate()
            except BaseException:
                _end(process)
                raise
            finally:
                self.running.remove(process)
                _ALL.discard(process)
        if process.returncode != 0:
            raise CompileError(f"{self.tools.version} failed ({process.returncode}):\n{said[-4000:]}")
