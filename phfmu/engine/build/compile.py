"""C sources -> shared library, cached by content (`cache.py`).

Compiler: `zig cc` of the wheel ziglang if it is installed (any target), else the system's (this machine only).
"""

from __future__ import annotations

import functools
import importlib.metadata
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from phfmu.engine.build import cache, objects
from phfmu.engine.build.objects import CompileError as CompileError  # one of the errors of `compile`
from phfmu.engine.build.objects import Toolchain

#: contraction to fused multiply-add would make results depend on the target
FLAGS = ("-std=c11", "-O2", "-g0", "-ffp-contract=off", "-fvisibility=hidden", "-fPIC")
LINK = ("-shared", "-s")
SUFFIX = {"linux": ".so", "macos": ".dylib", "windows": ".dll"}
SYSTEM = {"linux": "linux-gnu.2.17", "darwin": "macos", "win32": "windows-gnu"}
MACHINE = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


class CompilerMissing(RuntimeError):
    """No compiler for the target; the message says how to install one."""


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


#: zig's own run-time library, which takes it seconds to compile and these targets need nothing of; were
#: something of it needed after all, the linker says so
BARE = ("-nostdlib", "-lc", "-Wl,-z,defs")
BARE_TARGETS = ("x86_64-linux", "aarch64-linux")


def _zig(target: str, flags: Sequence[str]) -> Toolchain | None:
    spec = importlib.util.find_spec("ziglang")
    if spec is None or spec.origin is None:
        return None
    options = ("-target", target, "-fno-sanitize=undefined", *flags)
    version = f"zig {importlib.metadata.version('ziglang')}"
    bare = BARE if target.startswith(BARE_TARGETS) else ()
    # `python -m ziglang` starts this program, and an interpreter of its own for it every time
    zig = shutil.which("zig", path=Path(spec.origin).parent)
    program = (zig,) if zig else (sys.executable, "-m", "ziglang")
    return Toolchain((*program, "cc"), version, (*FLAGS, *options), (*LINK, *bare))


def _system(target: str, flags: Sequence[str]) -> Toolchain | None:
    if target != host_target():
        return None
    for name in ("cc", "gcc", "clang"):
        if path := shutil.which(name):
            return Toolchain((path,), _version(path) or name, (*FLAGS, *flags), LINK)
    return None


@functools.cache
def _version(path: str) -> str:
    """What the compiler says in its first line."""
    return subprocess.run([path, "--version"], capture_output=True, text=True).stdout.partition("\n")[0]


def _find(target: str, only: str | None, flags: Sequence[str] = ()) -> Toolchain:
    found = None
    if only in (None, "zig"):
        found = _zig(target, flags)
    if found is None and only in (None, "cc"):
        found = _system(target, flags)
    if found is None:
        host = host_target()
        missing = "and there is no cc, gcc or clang" if target == host else f"and cc builds for {host} only"
        raise CompilerMissing(
            f"no C compiler for {target}: ziglang is not installed, {missing}. "
            'Install one with: pip install "phfmu[native]"'
        )
    return found


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
    the compiler runs, not when the cache has the library. Sources that are texts, generated from a model, are
    compiled with the flags of PHFMU_MODEL_FLAGS besides.
    Errors: CompilerMissing, CompileError.
    """
    target = target or host_target()
    tools = _find(target, compiler, flags)
    if own := tuple(shlex.split(os.environ.get("PHFMU_MODEL_FLAGS", ""))):
        tools = replace(tools, own={n: own for n, s in sources.items() if isinstance(s, str) and n.endswith(".c")})
    files = {n: s.read_bytes() if isinstance(s, Path) else s.encode() for n, s in sources.items()}
    path = cache.find(tools.library_key(files), suffix(target))
    reused = path is not None
    if path is None:
        if announce is not None:
            announce()
        path = objects.build(files, tools, suffix(target))
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, out)
    return Build(out or path, reused, tools.version, target)


def require_compiler(target: str | None = None) -> str:
    """Version of the compiler for `target` (default: this machine); CompilerMissing if there is none."""
    return _find(target or host_target(), None).version
