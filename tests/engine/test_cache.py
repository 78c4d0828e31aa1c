"""The cache of compiled libraries: nothing damaged or foreign is loaded from it, and a run goes on without it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from phfmu.engine.build.compile import compile

#: the system's where there is one: it needs no cache of its own
COMPILER = "cc" if any(shutil.which(name) for name in ("cc", "gcc", "clang")) else None

#: compiles and calls a library in a process of its own, which a damaged one would end
LOADS = """
import ctypes, sys
from phfmu.engine.build.compile import compile
text = '__attribute__((visibility("default"))) int answer(void) { return 42; }'
built = compile({"answer.c": text}, compiler=sys.argv[1] or None)
print(built.path, built.reused, ctypes.CDLL(str(built.path)).answer())
"""
CALL = [sys.executable, "-c", LOADS, COMPILER or ""]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compiler: None) -> Path:
    """An empty cache; the compiler keeps what it has built of its own run time."""
    from phfmu.engine.build import cache

    made, known = tmp_path / "cache", cache.cache_folder()
    made.mkdir(mode=0o700)
    if (known / "zig").is_dir():
        (made / "zig").symlink_to(known / "zig")
    monkeypatch.setenv("PHFMU_CACHE_DIR", str(made))
    return made


def loaded() -> tuple[Path, bool, str]:
    """Path of the library, whether it came from the cache, what was said on stderr; its answer is right."""
    done = subprocess.run(CALL, capture_output=True, text=True)
    assert done.returncode == 0, done
    path, reused, answer = done.stdout.split()
    assert answer == "42"
    return Path(path), reused == "True", done.stderr


DAMAGE = {
    "cut off": lambda data: data[: len(data) // 2],
    "cut off at its end": lambda data: data[:-1],
    "empty": lambda data: b"",
    "a page of zeros": lambda data: data[:4096] + bytes(4096) + data[8192:],
    "one bit": lambda data: data[:-100] + bytes([data[-100] ^ 1]) + data[-99:],
    "another file": lambda data: b"#!/bin/sh\n",
}


def test_damaged_libraries_are_built_again(folder: Path) -> None:
    path, reused, err = loaded()
    assert (reused, err) == (False, "") and path.is_relative_to(folder)
    sound = path.read_bytes()
    assert loaded() == (path, True, "")
    for kind, change in DAMAGE.items():
        path.write_bytes(change(sound))
        again, reused, err = loaded()
        assert (reused, err) == (False, ""), kind
        assert again.read_bytes() == sound, kind


@pytest.mark.slow
def test_a_run_with_a_damaged_library(folder: Path) -> None:
    """The command line, with a model's library cut in half between two runs; objects are those of the other tests."""
    (folder / "lib").mkdir(mode=0o700)
    known = (folder / "zig").resolve().parent / "lib"  # where other tests compile in folders that vanish
    shared = {d for d in known.iterdir() if not d.name.startswith("tmp") and any(d.glob("*.o"))}
    for built in (p for p in shared if not p.name.startswith("tmp")):  # in those others are building just now
        (folder / "lib" / built.name).symlink_to(built)
    call = [sys.executable, "-c", "from phfmu.cli import main; raise SystemExit(main())"]
    words = [*call, "run", "mass", "--engine", "native", "--kernels", "compiled", "--stop", "0.01"]
    assert subprocess.run(words, capture_output=True).returncode == 0
    libraries = [p for p in (folder / "lib").rglob("*") if p.suffix in (".so", ".dylib", ".dll")]
    assert libraries
    for path in libraries:
        os.truncate(path, path.stat().st_size // 2)
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "") and "closed" in done.stdout


@pytest.mark.parametrize("part", ["", "lib"])
def test_a_cache_that_anybody_can_write_is_not_used(folder: Path, part: str) -> None:
    path, *_ = loaded()
    os.chmod(folder / part, 0o777)
    again, reused, err = loaded()
    assert not reused and not again.is_relative_to(folder) and not again.exists()  # private, gone with its process
    assert err.count("\n") == 1 and f"anybody can write to {folder / part}" in err
    os.chmod(folder / part, 0o700)
    assert loaded() == (path, True, "")


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="Windows has no such permissions")
@pytest.mark.parametrize("part", ["key", "library"])
def test_what_others_could_change_in_a_cache_is_not_loaded(folder: Path, part: str) -> None:
    path, *_ = loaded()
    os.chmod(path.parent if part == "key" else path, 0o777)
    again, reused, err = loaded()
    assert not reused and err == ""
    assert again.stat().st_mode & 0o022 == 0 and loaded() == (again, True, "")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give a group a folder")
def test_a_cache_of_a_group_is_not_used(folder: Path) -> None:
    """But one of the group that a user has alone is."""
    path, *_ = loaded()
    os.chmod(folder, 0o775)
    assert loaded() == (path, True, "")
    os.chown(folder, -1, 12345)
    again, reused, err = loaded()
    assert not reused and not again.is_relative_to(folder) and f"its group can write to {folder} (gid 12345)" in err


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="Windows has no such permissions")
@pytest.mark.parametrize(("mode", "used"), [(0o777, False), (0o1777, True), (0o755, True)])
def test_a_folder_above_the_cache_that_anybody_can_write(
    folder: Path, monkeypatch: pytest.MonkeyPatch, mode: int, used: bool
) -> None:
    """Who can move the cache away can put another one in its place, unless a sticky bit is there, as in /tmp."""
    above = folder.parent / "above"
    above.mkdir()
    (above / "mine").mkdir(mode=0o700)
    shutil.move(folder, above / "mine" / "cache")
    monkeypatch.setenv("PHFMU_CACHE_DIR", str(above / "mine" / "cache"))
    os.chmod(above, mode)
    path, _, err = loaded()
    assert path.is_relative_to(above) is used
    assert (err == "") if used else f"anybody can write to {above}" in err


def test_a_full_cache_is_named_and_the_library_is_built_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compiler: None
) -> None:
    small = tmp_path / "small"
    small.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8k,mode=700", "tmpfs", small], capture_output=True)
    if mounted.returncode:
        pytest.skip("a small file system cannot be mounted here")
    try:
        monkeypatch.setenv("PHFMU_CACHE_DIR", str(small / "cache"))
        path, reused, err = loaded()
        assert not reused and not path.is_relative_to(small)
        assert err.count("\n") == 1 and str(small) in err and "No space left on device" in err
    finally:
        subprocess.run(["umount", small], check=True)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give a folder away")
def test_a_cache_of_another_user_is_not_used(folder: Path) -> None:
    loaded()
    os.chown(folder, 12345, -1)
    path, reused, err = loaded()
    assert not reused and not path.is_relative_to(folder)
    assert err.count("\n") == 1 and "belongs to another user (uid 12345)" in err


def test_a_cache_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], compiler: None
) -> None:
    """It is said once; the process keeps its libraries for itself."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("PHFMU_CACHE_DIR", str(tmp_path / "file" / "cache"))
    source = {"a.c": "int a;"}
    first, again, other = (compile(s, compiler=COMPILER) for s in (source, source, {"b.c": "int b;"}))
    assert (first.reused, again.reused, other.reused) == (False, True, False) and first.path == again.path
    err = capfd.readouterr().err
    assert err.count("\n") == 1 and "cannot be written" in err and "PHFMU_CACHE_DIR names another" in err
    if hasattr(os, "geteuid"):
        assert first.path.parents[2].stat().st_mode & 0o077 == 0


def test_concurrent_builds_of_one_library(folder: Path) -> None:
    runs = [subprocess.Popen(CALL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(3)]
    for run in runs:
        out, err = run.communicate(timeout=120)
        assert run.returncode == 0 and err == "" and out.split()[2] == "42"
    assert loaded()[1]
    assert [p.name for p in (folder / "lib").iterdir() if p.name.startswith("tmp")] == []
