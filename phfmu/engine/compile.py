"""C sources -> shared library, cached by content (`cache.py`).

Compiler: `python -m ziglang cc` if ziglang is installed (any target), else the system's (this machine only).
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from phfmu.engine import cache

#: contraction to fused multiply-add would make results depend on the target
FLAGS = ("-std=c11", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-shared", "-fPIC", "-s")
SUFFIX = {"linux": ".so", "macos": ".dylib", "windows": ".dll"}
SYSTEM = {"linux": "linux-gnu.2.17", "darwin": "macos", "win32": "windows-gnu"}
MACHINE = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


class CompilerMissing(RuntimeError):
    """No compiler for the target; the message says how to install one."""


class CompileError(RuntimeError):
    """The compiler refused the sources; the message holds its output."""


@dataclass(frozen=True)
class Build:
    """A compiled library; `reused`: it came from the cache."""

    path: Path
    reused: bool
    compiler: str
    target: str


def host_target() -> str:
    """Target triple of this machine; glibc 2.17 so that the library runs on older systems too."""
    machine = MACHINE.get(platform.machine().lower(), platform.machine().lower())
    system = next((s for key, s in SYSTEM.items() if sys.platform.startswith(key)), sys.platform)
    return f"{machine}-{system}"


#: what Linux calls the instructions of the x86-64-v3 level that lanes use
LEVEL_3 = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}


def host_flags(compiler: str | None = None) -> tuple[str, ...]:
    """Flags for the wider vectors of this machine (x86-64-v3), none where it does not say that it has them.

    Only for libraries that stay here.  Results are the same bits: contraction is off and vectors are no wider than
    the lanes of the source.
    """
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return ()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return ()
    found = next((set(line.split()) for line in lines if line.startswith("flags")), set())
    if not found >= LEVEL_3:
        return ()
    zig = compiler != "cc" and importlib.util.find_spec("ziglang") is not None
    return ("-mcpu=x86_64_v3",) if zig else ("-march=x86-64-v3",)


def suffix(target: str) -> str:
    """File name extension of a shared library for the target."""
    return SUFFIX.get(target.split("-")[1], ".so")


@dataclass(frozen=True)
class _Compiler:
    command: tuple[str, ...]
    version: str
    flags: tuple[str, ...]


def _zig(target: str) -> _Compiler | None:
    if importlib.util.find_spec("ziglang") is None:
        return None
    flags = ("-target", target, "-fno-sanitize=undefined")
    version = f"zig {importlib.metadata.version('ziglang')}"
    return _Compiler((sys.executable, "-m", "ziglang", "cc"), version, flags)


def _system(target: str) -> _Compiler | None:
    if target != host_target():
        return None
    for name in ("cc", "gcc", "clang"):
        if path := shutil.which(name):
            lines = subprocess.run([path, "--version"], capture_output=True, text=True).stdout.splitlines()
            return _Compiler((path,), lines[0] if lines else name, ())
    return None


def _find(target: str, only: str | None) -> _Compiler:
    found = None
    if only in (None, "zig"):
        found = _zig(target)
    if found is None and only in (None, "cc"):
        found = _system(target)
    if found is None:
        host = host_target()
        missing = "and there is no cc, gcc or clang" if target == host else f"and cc builds for {host} only"
        raise CompilerMissing(
            f"no C compiler for {target}: ziglang is not installed, {missing}. "
            'Install one with: pip install "phfmu[native]"'
        )
    return found


def _key(sources: Mapping[str, str | Path], command: Sequence[str], version: str) -> str:
    digest = hashlib.sha256(repr((list(command), version)).encode())
    for name in sorted(sources):
        source = sources[name]
        content = source.read_bytes() if isinstance(source, Path) else source.encode()
        digest.update(f"\0{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:32]


def _build(sources: Mapping[str, str | Path], compiler: _Compiler, flags: Sequence[str], key: str, end: str) -> Path:
    """Compiles in a private folder and moves the result into the cache: nobody sees half a file.

    The private folder is searched for headers only if it has some: its name would be part of what zig's own cache
    knows an object by, and the runtime, the same for every model, would be compiled anew for each.
    """
    root = cache.writable()
    env = os.environ | {
        "ZIG_GLOBAL_CACHE_DIR": str(root / "zig"),
        "ZIG_LOCAL_CACHE_DIR": str(root / "zig" / "local"),
    }
    with tempfile.TemporaryDirectory(dir=root / "lib") as folder:
        work = Path(folder)
        files, folders = [], []
        for name, source in sorted(sources.items()):
            path = source if isinstance(source, Path) else work / name
            if isinstance(source, str):
                path.write_text(source, encoding="utf-8")
            if name.endswith(".c"):
                files.append(str(path))
            if path.parent not in folders and (isinstance(source, Path) or not name.endswith(".c")):
                folders.append(path.parent)
        includes = [f"-I{f}" for f in folders]
        result = work / ("library" + end)
        command = [*compiler.command, *flags, *includes, *files, "-o", str(result), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, env=env)
        if done.returncode != 0:
            raise CompileError(f"{compiler.version} failed ({done.returncode}):\n{done.stderr[-4000:]}")
        return cache.put(root, key, result)


def compile(
    sources: Mapping[str, str | Path],
    target: str | None = None,
    out: Path | None = None,
    *,
    flags: Sequence[str] = (),
    compiler: str | None = None,
    announce: Callable[[], None] | None = None,
) -> Build:
    """Shared library of C sources for a target (default: this machine), from the cache if it is there.

    `sources`: file name -> text or path; names not ending in .c are only included. `out`: copy of the result.
    `flags`: further compiler flags. `compiler`: "zig" or "cc" to insist on one. `announce`: called before
    the compiler runs, not when the cache has the library.
    Errors: CompilerMissing, CompileError.
    """
    target = target or host_target()
    found = _find(target, compiler)
    options = (*FLAGS, *found.flags, *flags)
    key = _key(sources, (*found.command[1:], *options), found.version)
    path = cache.find(key, suffix(target))
    reused = path is not None
    if path is None:
        if announce is not None:
            announce()
        path = _build(sources, found, options, key, suffix(target))
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, out)
    return Build(out or path, reused, found.version, target)


def require_compiler(target: str | None = None) -> str:
    """Version of the compiler for `target` (default: this machine); CompilerMissing if there is none."""
    return _find(target or host_target(), None).version
