"""Objects of libraries: compiled once for all that share them, anew when anything they are made of changes."""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from phfmu import interrupt
from phfmu.components.mechanical.translational import mass
from phfmu.discretise.model import build_model
from phfmu.engine.build import cache, objects
from phfmu.engine.build import compile as build
from phfmu.engine.build.compile import LONG, CompileError, compile, compile_once, host_flags, ship
from phfmu.engine.build.kernels import Kernels
from phfmu.engine.build.runtime_sources import PARTS, STEPS, library_sources, runtime_sources
from phfmu.engine.model import kernels
from phfmu.engine.native.code import CompiledCode, source
from phfmu.engine.native.library import backwards, drivers, runtime
from phfmu.fmu.export.export import export

#: two sources that share a header by way of another, and one that stands alone
SOURCES = {
    "a.c": '#include "outer.h"\nPH int a(void) { return VALUE; }\n',
    "b.c": '  #  include "inner.h"\nint b(void) { return VALUE + 1; }\n',
    "c.c": "#include <math.h>\ndouble c(double x) { return sin(x); }\n",
    "outer.h": '#define PH __attribute__((visibility("default")))\n#include "inner.h"\n',
    "inner.h": "#define VALUE 1\n",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compiler: None) -> Path:
    """An empty cache and a package without libraries; the compiler keeps what it has built of its own run time."""
    made, known = tmp_path / "cache", cache.cache_folder()
    made.mkdir(mode=0o700)
    (known / "zig").mkdir(parents=True, exist_ok=True)
    (made / "zig").symlink_to(known / "zig")
    monkeypatch.setenv("PHFMU_CACHE_DIR", str(made))
    monkeypatch.setattr(build, "SHIPPED", tmp_path / "shipped")
    return made


@pytest.fixture
def compiled(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[str]]:
    """The sources compiled since the last call, in alphabetical order."""
    run, said = subprocess.Popen, list[str]()

    def watched(command, **more):
        sources = [word for word in command if word.endswith(".c")]
        said.extend(sources if "-c" in command else [])
        return run(command, **more)

    monkeypatch.setattr(objects.subprocess, "Popen", watched)

    def since() -> list[str]:
        found = sorted(said)
        said.clear()
        return found

    return since


def made(**parameters: float) -> CompiledCode:
    found = Kernels(kernels(build_model(mass(2.0, **parameters))))
    return CompiledCode(found, source(found, None))


def test_a_further_library_compiles_only_what_others_have_not(
    compiled: Callable[[], list[str]],
) -> None:
    steps, back, sources = runtime_sources(*STEPS), runtime_sources(*PARTS), library_sources()
    runtime()
    assert compiled() == sorted(n for n in steps if n.endswith(".c"))
    backwards()
    assert compiled() == ["reverse.c", "reverse_steps.c", "tape.c"]
    drivers()
    assert compiled() == sorted(n for n in sources if n.endswith(".c") and n not in back)
    assert not made(k=100.0).build.reused
    assert compiled() == ["kernels.c"]
    assert not made().build.reused
    assert compiled() == ["kernels.c"]
    assert made().build.reused
    assert not compile(sources | {"more.c": "int more;\n"}, flags=host_flags()).reused
    assert compiled() == ["more.c"]


def test_libraries_of_a_package_need_no_compiler(
    folder: Path, tmp_path: Path, compiled: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a wheel has is of this machine's kind; what is damaged, or of another source, is not taken."""
    pytest.importorskip("ziglang")
    paths = {name: tmp_path / name for name in SOURCES}
    for name, path in paths.items():
        path.write_text(SOURCES[name])
    ship(build.SHIPPED, [paths])
    assert compiled() == sorted(2 * ["a.c", "b.c", "c.c"]) if platform.machine() == "x86_64" else ["a.c", "b.c", "c.c"]

    def missing(*_: object) -> None:
        raise build.CompilerMissing("none here")

    monkeypatch.setattr(build, "_find", missing)
    found = compile_once(paths)
    assert found.reused and found.path.is_relative_to(build.SHIPPED) and ctypes.CDLL(str(found.path)).a() == 1
    for path in build.SHIPPED.rglob("*.*"):
        path.write_bytes(path.read_bytes() + b" ")
    with pytest.raises(build.CompilerMissing, match="none here"):
        compile_once(paths)
    assert list(build.SHIPPED.glob("*/*"))  # a package is not written to
    paths["c.c"].write_text(SOURCES["c.c"] + "\n")
    with pytest.raises(build.CompilerMissing):
        compile_once(paths)


def test_a_change_compiles_what_it_reaches_and_nothing_else(compiled: Callable[[], list[str]]) -> None:
    compile(SOURCES)
    assert compiled() == ["a.c", "b.c", "c.c"]
    for changed, reached in (
        ("inner.h", ["a.c", "b.c"]), ("outer.h", ["a.c"]), ("c.c", ["c.c"]), ("b.c", ["b.c"]),
    ):  # fmt: skip
        compile({**SOURCES, changed: SOURCES[changed] + "\n"})
        assert compiled() == reached, changed
    compile(SOURCES, flags=("-DX=1",))
    assert compiled() == ["a.c", "b.c", "c.c"]
    compile({**SOURCES, "unused.h": ""})
    assert compiled() == []


def test_flags_for_models_compile_what_is_generated_and_nothing_else(
    tmp_path: Path, compiled: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The runtime, which stands in files, is of the same objects; the libraries are two."""
    monkeypatch.delenv("PHFMU_MODEL_FLAGS", raising=False)
    (tmp_path / "file.c").write_text("int file(void) { return 1; }\n")
    sources = {**SOURCES, "file.c": tmp_path / "file.c"}
    plain = compile(sources).path
    assert compiled() == ["a.c", "b.c", "c.c", "file.c"]
    monkeypatch.setenv("PHFMU_MODEL_FLAGS", "-O0 -DX=1")
    other = compile(sources).path
    assert compiled() == ["a.c", "b.c", "c.c"] and other != plain
    assert compile(sources).reused and compile({"file.c": sources["file.c"]}).path != other
    assert compiled() == []
    monkeypatch.delenv("PHFMU_MODEL_FLAGS")
    assert compile(sources).path == plain


def test_long_generated_sources_are_compiled_without_the_vectors_of_blocks(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Short ones, and files however long, keep the flags of all."""
    run, said = subprocess.Popen, dict[str, bool]()

    def watched(command, **more):
        said.update({w: "-fno-tree-slp-vectorize" in command for w in command if w.endswith(".c") and "-c" in command})
        return run(command, **more)

    monkeypatch.setattr(objects.subprocess, "Popen", watched)
    (tmp_path / "file.c").write_text(f"/*{'-' * LONG}*/ int file(void) {{ return 1; }}\n")
    compile({**SOURCES, "a.c": SOURCES["a.c"] + f"/*{'-' * LONG}*/\n", "file.c": tmp_path / "file.c"})
    assert said == {"a.c": True, "b.c": False, "c.c": False, "file.c": False}


def test_includes_are_found_through_others_and_in_a_circle() -> None:
    files = {n: t.encode() for n, t in SOURCES.items()}
    assert set(objects.needed("a.c", files)) == {"a.c", "outer.h", "inner.h"}
    assert set(objects.needed("c.c", files)) == {"c.c"}
    assert set(objects.needed("x.h", {"x.h": b'#include "y.h"', "y.h": b'#include "x.h"'})) == {"x.h", "y.h"}


def test_damaged_objects_are_compiled_again(folder: Path, compiled: Callable[[], list[str]]) -> None:
    sound = compile(SOURCES).path.read_bytes()
    compiled()
    for library in (folder / "lib").glob("*/*.*"):
        if library.suffix != ".o":
            library.unlink()
    (victim,) = [p for p in (folder / "lib").glob("*/*.o") if b"a.c" in p.read_bytes()]
    victim.write_bytes(victim.read_bytes()[:-100])
    assert compile(SOURCES).path.read_bytes() == sound
    assert compiled() == ["a.c"]


@pytest.mark.slow
def test_a_unit_has_the_same_bytes_from_a_cold_and_a_warm_cache(
    folder: Path, tmp_path: Path, compiled: Callable[[], list[str]]
) -> None:
    """Also where the objects came with another unit of the same equations."""
    model = build_model(mass(2.0, k=100.0))
    (cold,) = export(model, tmp_path / "cold", ("3.0",), step=0.01)
    assert "kernels.c" in compiled()
    export(model, tmp_path / "other", ("3.0",), step=0.02)
    assert compiled() == ["interface.c"]
    for library in (p for p in (folder / "lib").glob("*/*.*") if p.suffix != ".o"):
        library.unlink()
    (warm,) = export(model, tmp_path / "warm", ("3.0",), step=0.01)
    assert compiled() == [] and warm.read_bytes() == cold.read_bytes()


def test_objects_are_the_same_bytes_wherever_the_cache_stands(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = compile(SOURCES).path
    (tmp_path / "deeper" / "cache").mkdir(parents=True, mode=0o700)
    (tmp_path / "deeper" / "cache" / "zig").symlink_to((folder / "zig").resolve())
    monkeypatch.setenv("PHFMU_CACHE_DIR", str(tmp_path / "deeper" / "cache"))
    other = compile(SOURCES).path
    names = [sorted(p.name for p in path.parents[1].glob("*/*")) for path in (one, other)]  # content hashes
    assert one != other and names[0] == names[1] and len(names[0]) == 4


#: compiles libraries that share objects; the source that differs is named by the caller
SHARES = f"""
import ctypes, sys
from phfmu.engine.build.compile import compile
sources = {SOURCES!r} | {{"own.c": "int own" + sys.argv[1] + ";"}}
print(ctypes.CDLL(str(compile(sources).path)).a())
"""


def test_processes_that_compile_the_same_objects_at_once(folder: Path) -> None:
    calls = [[sys.executable, "-c", SHARES, str(i)] for i in range(3)]
    runs = [subprocess.Popen(c, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for c in calls]
    assert [run.communicate(timeout=120) for run in runs] == [("1\n", "")] * 3
    shared = [p for p in (folder / "lib").glob("*/*.o") if b"own" not in p.read_bytes()]
    assert len(shared) == len({p.parent for p in shared}) == 3  # one object a key, whoever came last
    assert [p.name for p in (folder / "lib").iterdir() if p.name.startswith("tmp")] == []


@pytest.mark.skipif(sys.platform == "win32", reason="kills a group of processes")
def test_a_killed_compilation_leaves_nothing_that_is_used(folder: Path, compiled: Callable[[], list[str]]) -> None:
    code = f"""
from phfmu.engine.build.compile import compile
lines = "".join("double f%d(double x) {{ return x * %d + f%d(x); }}\\n" % (i, i, i - 1) for i in range(1, 3000))
compile({SOURCES!r} | {{"large.c": "double f0(double x) {{ return x; }}\\n" + lines}})
"""
    run = subprocess.Popen([sys.executable, "-c", code], start_new_session=True, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not list((folder / "lib").glob("[!t]*/*.o")) and time.monotonic() < deadline:  # in its place, not in tmp...
        time.sleep(0.002)
    os.killpg(run.pid, signal.SIGKILL)
    assert run.wait() == -signal.SIGKILL
    library = compile(SOURCES).path
    assert set(compiled()) < {"a.c", "b.c", "c.c"}
    call = [sys.executable, "-c", f"import ctypes; print(ctypes.CDLL({str(library)!r}).a())"]
    assert subprocess.run(call, capture_output=True, text=True).stdout == "1\n"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems' libraries need it")
def test_the_first_library_does_not_wait_for_a_run_time_it_does_not_need(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """zig compiles a library of its own for whoever links with it, for eight seconds of CPU time."""
    pytest.importorskip("ziglang")
    monkeypatch.setenv("PHFMU_CACHE_DIR", str(tmp_path))
    compile(SOURCES, compiler="zig")
    assert list((tmp_path / "zig").rglob("libc.so.6")) and not list((tmp_path / "zig").rglob("*compiler_rt*"))
    with pytest.raises(CompileError, match="nowhere"):  # what is missing is found by the linker, not in the importer
        compile({**SOURCES, "a.c": '#include "outer.h"\nint nowhere(void);\nPH int a(void) { return nowhere(); }\n'})


def test_no_interpreter_is_started_for_every_source(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """`python -m ziglang` would cost half as much as the compilation of a small file."""
    pytest.importorskip("ziglang")
    run, programs = subprocess.Popen, set[str]()

    def watched(command, **more):
        programs.add(command[0])
        return run(command, **more)

    monkeypatch.setattr(objects.subprocess, "Popen", watched)
    compile(SOURCES, compiler="zig")
    assert [Path(p).stem for p in programs] == ["zig"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("kept", [False, True])
def test_a_signal_ends_a_build_and_its_compilers(folder: Path, tmp_path: Path, kept: bool) -> None:
    """Where signals raise, and within a run, where the first one is kept for those who ask."""
    slow, begun = tmp_path / "cc", tmp_path / "begun"
    slow.write_text(f'#!/bin/sh\n[ "$1" = --version ] && echo slow && exit\necho $$ >> {begun}\nsleep 300\n')
    slow.chmod(0o755)
    code = (
        "import signal, sys\nfrom phfmu.engine.build.compile import compile\nfrom phfmu.interrupt import Signals, raising\n"
        f"with {'Signals' if kept else 'raising'}():\n    compile({SOURCES!r}, compiler='cc')"
    )
    here = os.environ | {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    run = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True, env=here)
    try:
        late = time.monotonic() + 60
        while not begun.exists() and time.monotonic() < late:
            time.sleep(0.05)
        run.send_signal(signal.SIGTERM)
        _, err = run.communicate(timeout=30)
    finally:
        run.kill()
        run.wait()
    assert "phfmu.interrupt.Interrupted: SIGTERM" in err
    for process in map(int, begun.read_text().split()):
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)
    assert not list((folder / "lib").glob("tmp*"))


def test_a_compiler_that_starts_as_the_work_ends_is_ended_too(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The others are ended while it is still being started, before it is among those at work."""
    slow = tmp_path / "cc"
    slow.write_text(
        '#!/bin/sh\n[ "$1" = --version ] && echo slow && exit\ncase "$*" in *b.c*) exit 1;; esac\nsleep 300\n'
    )
    slow.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    true, failed = objects.subprocess.Popen, threading.Event()

    def late(command: list[str], **more: object) -> object:
        process = true(command, **more)
        if "b.c" in command:
            failed.set()
        elif "--version" not in command:
            failed.wait()
            time.sleep(3 * interrupt.SLICE)
        return process

    monkeypatch.setattr(objects.subprocess, "Popen", late)
    begun = time.monotonic()
    with pytest.raises(CompileError):
        compile(SOURCES, compiler="cc")
    assert time.monotonic() - begun < 60
