"""C sources -> shared library, cached by content (`cache.py`).

Compiler: `zig cc` of the wheel ziglang if it is installed (any target), else the system's (this machine only).
"""

from __future__ import annotations

import functools
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from phfmu.engine.build import cache, objects
from phfmu.engine.build.objects import CompileError as CompileError  # one of the errors of `compile`
from phfmu.engine.build.objects import Toolchain

#: contraction to fused multiply-add would make results depend on the target, and powers of constants that become calls of
#: other functions on the compiler
FLAGS = ("-std=c11", "-O2", "-g0", "-ffp-contract=off", "-fno-builtin-pow", "-fvisibility=hidden", "-fPIC")
#: flags of generated sources above this many characters (some 8000 operations), besides: Clang's search for equal operations
#: side by side takes more than all else of a long block, and what it finds there makes no step faster
LONG, LONG_FLAGS = 200_000, ("-fno-tree-slp-vectorize",)
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


#: the flags of zig for the x86-64-v3 level
ZIG_WIDE = ("-mcpu=x86_64_v3",)
#: names by Linux of the instructions of the x86-64-v3 level that lanes use
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
    return ZIG_WIDE if zig else ("-march=x86-64-v3",)


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
    from importlib.metadata import version

    options = ("-target", target, "-fno-sanitize=undefined", *flags)
    bare = BARE if target.startswith(BARE_TARGETS) else ()
    # `python -m ziglang` starts this program, and an interpreter of its own for it every time
    zig = shutil.which("zig", path=Path(spec.origin).parent)
    program = (zig,) if zig else (sys.executable, "-m", "ziglang")
    return Toolchain((*program, "cc"), f"zig {version('ziglang')}", (*FLAGS, *options), (*LINK, *bare))


def _system(target: str, flags: Sequence[str]) -> Toolchain | None:
    if target != host_target():
        return None
    for name in ("cc", "gcc", "clang"):
        if path := shutil.which(name):
            return Toolchain((path,), _version(path) or name, (*FLAGS, *flags), LINK)
    return None


@functools.cache
def _version(path: str) -> str:
    """The first line that the compiler prints about itself."""
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


@dataclass(frozen=True)
class GeneratedSource:
    """A source whose text is made when it is needed; `content` stands for it in the cache: the same for no other text."""

    content: str
    text: Callable[[], str]

    def with_text(self) -> GeneratedSource:
        """The same source, whose text is made now."""
        text = self.text()
        return replace(self, text=lambda: text)


Source = str | Path | GeneratedSource


def _bytes(source: Source, content: bool) -> bytes:
    if isinstance(source, Path):
        return source.read_bytes()
    if isinstance(source, GeneratedSource):
        source = source.content if content else source.text()
    return source.encode()


def _generated(sources: Mapping[str, Source]) -> list[str]:
    """Names of those that are generated from a model, not files."""
    return [n for n, s in sources.items() if not isinstance(s, Path) and n.endswith(".c")]


@dataclass(frozen=True)
class _LibraryRequest:
    """A request for a library: sources, target and compiler."""

    sources: Mapping[str, Source]
    target: str
    tools: Toolchain

    @classmethod
    def of(
        cls, sources: Mapping[str, Source], target: str | None, flags: Sequence[str], compiler: str | None
    ) -> _LibraryRequest:
        target = target or host_target()
        tools = _find(target, compiler, flags)
        if own := tuple(shlex.split(os.environ.get("PHFMU_MODEL_FLAGS", ""))):
            tools = replace(tools, own=dict.fromkeys(_generated(sources), own))
        return cls(sources, target, tools)

    @cached_property
    def key(self) -> str:
        return self.tools.library_key({n: _bytes(s, True) for n, s in self.sources.items()})

    def find(self) -> Build | None:
        path = cache.find(self.key, suffix(self.target))
        return None if path is None else Build(path, True, self.tools.version, self.target)

    def build(self) -> Build:
        files = {n: _bytes(s, False) for n, s in self.sources.items()}
        own = self.tools.own
        long = {n: (*LONG_FLAGS, *own.get(n, ())) for n in _generated(self.sources) if len(files[n]) > LONG}
        path = objects.build(files, replace(self.tools, own={**own, **long}), suffix(self.target), self.key)
        return Build(path, False, self.tools.version, self.target)


def find(sources: Mapping[str, Source], *, flags: Sequence[str] = ()) -> Build | None:
    """The build that `compile` gives for this machine if it needs no compiler, from the cache."""
    try:
        return _LibraryRequest.of(sources, None, flags, None).find()
    except CompilerMissing:
        return None


def compile(
    sources: Mapping[str, Source],
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
    compiled with the flags of PHFMU_MODEL_FLAGS besides, long ones with `LONG_FLAGS`.
    Errors: CompilerMissing, CompileError.
    """
    asked = _LibraryRequest.of(sources, target, flags, compiler)
    built = asked.find()
    if built is None:
        if announce is not None:
            announce()
        built = asked.build()
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(built.path, out)
    return replace(built, path=out or built.path)


#: folder in which a wheel has the libraries that all models have in common, compiled for its platform
SHIPPED = Path(__file__).parent / "shipped"


def _common_key(sources: Mapping[str, Path], target: str, wide: bool) -> str:
    """Name of a library that no compiler is part of; `wide`: with the vectors of `host_flags`."""
    files = {n: _bytes(s, True) for n, s in sources.items()}
    return Toolchain((), "any", (*FLAGS, target, str(wide)), LINK).library_key(files)


def compile_once(sources: Mapping[str, Path], announce: Callable[[], None] | None = None) -> Build:
    """Shared library for this machine, with all it can do: the one in the package, else compiled; the one in the cache if there
    is no compiler any more."""
    target = host_target()
    key = _common_key(sources, target, bool(host_flags()))
    if path := cache.whole(SHIPPED / key, suffix(target)):
        return Build(path, True, "none", target)
    try:
        built = compile(sources, flags=host_flags(), announce=announce)
    except CompilerMissing as missing:
        if path := cache.find(key, suffix(target)):
            return Build(path, True, "none", target)
        raise CompilerMissing(f"{missing}; once, for what steps all models") from None
    if cache.find(key, suffix(target)) is None:
        root = cache.writable()
        with tempfile.TemporaryDirectory(dir=root / "lib") as folder, suppress(OSError):
            cache.put(root, key, Path(shutil.copy(built.path, folder)))
    return built


def ship(folder: Path, libraries: Iterable[Mapping[str, Path]]) -> None:
    """Puts libraries for all machines of this kind into the folder SHIPPED of a package; CompilerMissing without zig."""
    target = host_target()
    for sources in libraries:
        for wide in (False, True) if target.startswith("x86_64") else (False,):
            built = compile(sources, flags=ZIG_WIDE if wide else (), compiler="zig")
            place = folder / _common_key(sources, target, wide) / built.path.name
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(built.path, place)


def require_compiler(target: str | None = None) -> str:
    """Version of the compiler for `target` (default: this machine); CompilerMissing if there is none."""
    return _find(target or host_target(), None).version
