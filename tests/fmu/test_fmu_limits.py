"""Hostile archives: refused with number and remedy, in little memory; units for other machines can be read."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from phfmu.cli import main
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.inspect import fmu_info
from phfmu.fmu.importer.reader import FMUInstance
from tests.fmu import foreign
from tests.wide import slow

#: room a reader may take beyond what it takes to read nothing, bytes
ROOM = 130_000_000

READ = f"""
import resource, sys
import fmpy
from phfmu.fmu.importer.inspect import fmu_info
from phfmu.fmu.export.variables import FMUError
pages = int(open("/proc/self/statm").read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + {ROOM},) * 2)
try:
    text = fmu_info(sys.argv[1])
    print("read", len(text))
except FMUError as error:
    print("refused", error)
"""


def read_in_little_memory(path: Path) -> str:
    """What reading the unit says in a process that may grow by ROOM."""
    done = subprocess.run([sys.executable, "-c", READ, str(path)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def variable(i: int) -> str:
    return f'<Float64 name="v{i}" valueReference="{i}" causality="local" description="quantity {i} of the plant"/>'


def repeated(path: Path, name: str, head: bytes, body: bytes, times: int, tail: bytes) -> Path:
    """An archive with one entry of a long repetition, written without holding it."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as out, out.open(name, "w") as entry:
        entry.write(head)
        block, rest = divmod(times, 10_000)
        many = body * 10_000
        for _ in range(block):
            entry.write(many)
        entry.write(body * rest + tail)
    return path


HEAD, TAIL = (part.encode() for part in foreign.description("3.0", "|").split("|"))
MD = "modelDescription.xml"
on_linux = pytest.mark.skipif(sys.platform != "linux", reason="memory is limited by Linux here")


@on_linux
@pytest.mark.parametrize(
    ("entry", "head", "body", "times", "words"),
    [
        slow((MD, HEAD, b'<String name="a" valueReference="1"/>', 150_000, "more than 100000")),
        ("resources/zeros", b"", bytes(1000), 80_000, "times longer when extracted than packed"),
        slow((MD, b"", bytes(1000), 80_000, "times longer")),
        (MD, HEAD + b'<Float64 name="', b"n" * 100, 150_000, "bytes in one tag"),
        slow((MD, HEAD + b"<!--", b"-n" * 50, 150_000, "bytes in one tag, comment")),
        (MD, HEAD, b"<a>", 20_000, "101 tags within each other"),
    ],
    ids=["strings", "zeros beside", "zeros", "long name", "long comment", "deep"],
)
def test_long_entries_are_refused_with_number_and_remedy(
    tmp_path: Path, entry: str, head: bytes, body: bytes, times: int, words: str
) -> None:
    path = repeated(tmp_path / "x.fmu", entry, head, body, times, TAIL)
    if entry != MD:
        with zipfile.ZipFile(path, "a") as out:
            out.writestr(MD, HEAD + TAIL)
    said = read_in_little_memory(path)
    assert said.startswith("refused") and any(w in said for w in words.split("|")), said
    assert "PHFMU_LIMITS=" in said or "damaged" in said


@pytest.mark.slow
@on_linux
@pytest.mark.parametrize("distinct", [pytest.param(True, marks=pytest.mark.slow), False], ids=["names", "variables"])
def test_many_distinct_entries_are_refused_in_little_memory(tmp_path: Path, distinct: bool) -> None:
    """120 000 variables, or as many different tags: what is kept and what the parser keeps is bounded."""
    if distinct:
        body = "</ModelVariables><ModelVariables2>" + "".join(f'<t{i} a{i}="{i}"/>' for i in range(600_000))
        body += "</ModelVariables2><ModelVariables>"
    else:
        body = "".join(variable(i) for i in range(120_000))
    path = foreign.archive(tmp_path / "x.fmu", {MD: foreign.description("3.0", body)})
    said = read_in_little_memory(path)
    assert said.startswith("refused") and ("600000" if distinct else "100000") in said


@on_linux
def test_large_honest_units_are_read(tmp_path: Path) -> None:
    body = "".join(variable(i) for i in range(30_000))
    path = foreign.archive(tmp_path / "x.fmu", {MD: foreign.description("3.0", body)})
    assert read_in_little_memory(path).startswith("read")


def test_limits_are_scaled_by_one_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    body = "".join(variable(i) for i in range(1100))
    path = foreign.archive(tmp_path / "x.fmu", {MD: foreign.description("3.0", body)})
    monkeypatch.setattr("phfmu.fmu.limits.VARIABLES", 1000)
    with pytest.raises(FMUError, match="1001 variables, more than 1000; refused.*PHFMU_LIMITS=2 "):
        fmu_info(path)
    monkeypatch.setenv("PHFMU_LIMITS", "2")
    assert "v1099" in fmu_info(path)
    monkeypatch.setenv("PHFMU_LIMITS", "much")
    with pytest.raises(FMUError, match="PHFMU_LIMITS=much: expected a number from 1"):
        fmu_info(path)


def test_entities_are_refused_wherever_they_stand(tmp_path: Path) -> None:
    laughs = '<!DOCTYPE x [<!ENTITY a "ha">' + "".join(f'<!ENTITY a{i} "&a;&a;">' for i in range(30)) + "]>"
    good = foreign.description("3.0", variable(1))
    head, rest = good.split("\n", 1)
    for text in (f"{head}\n{laughs}{rest}", f"{head}<!--{'x' * 70_000}-->{laughs}{rest}"):
        path = foreign.archive(tmp_path / "x.fmu", {MD: text})
        with pytest.raises(FMUError, match="document type definition"):
            fmu_info(path)
    path = foreign.archive(tmp_path / "x.fmu", {MD: good.replace("UTF-8", "UTF-7")})
    with pytest.raises(FMUError, match="not in UTF-8"):
        fmu_info(path)


def test_archives_with_odd_lists_of_files_are_refused(tmp_path: Path) -> None:
    good, path = foreign.description("3.0", variable(1)), tmp_path / "x.fmu"
    foreign.archive(path, {MD: good, **{f"resources/{i}": "" for i in range(20_001)}})
    with pytest.raises(FMUError, match="20002 files in the archive, more than 20000"):
        fmu_info(path)
    foreign.archive(path, {MD: good, **{f"resources/{'x' * 3000}{i}": "" for i in range(1500)}})
    with pytest.raises(FMUError, match="bytes to be read at once, e.g. in the list of files, more than 4194304"):
        fmu_info(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as out:
        out.writestr(MD, good)
    with pytest.raises(FMUError, match="is packed by method 14; the standard allows store and deflate"):
        fmu_info(path)
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(path, "w") as out:
        out.writestr(MD, good)
        out.writestr(MD, good)
    with pytest.raises(FMUError, match="holds 'modelDescription.xml' twice"):
        fmu_info(path)


@on_linux
def test_a_size_that_lies_is_not_believed(tmp_path: Path) -> None:
    """The list of files says 1000 bytes where 200 MB are packed."""
    path = repeated(tmp_path / "x.fmu", MD, b"", bytes(1000), 200_000, b"")
    data = bytearray(path.read_bytes())
    size = (200_000_000).to_bytes(4, "little")
    at = data.rindex(size)
    data[at : at + 4] = (1000).to_bytes(4, "little")
    path.write_bytes(data)
    assert read_in_little_memory(path).startswith("refused")


def test_a_unit_for_other_machines_is_read_and_not_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = foreign.archive(
        tmp_path / "x.fmu", {MD: foreign.description("3.0", variable(1)), "binaries/amiga-m68k/foreign.so": b""}
    )
    assert main(["info", str(path)]) == 0
    said = capsys.readouterr().out
    assert "libraries for: amiga-m68k (none for this machine" in said and "v1" in said
    assert main(["run", str(path)]) == 2
    assert "no library for this platform" in (said := capsys.readouterr().err) and "the archive has amiga-m68k" in said
    with pytest.raises(FMUError, match="run it on one of those"):
        FMUInstance(path)


def test_what_is_printed_of_a_unit_cannot_steer_the_terminal(tmp_path: Path) -> None:
    body = '<Float64 name="v" valueReference="1" description="ab&#x9b;31m&#x202e;&#10;forged line"/>'
    path = foreign.archive(tmp_path / "x.fmu", {MD: foreign.description("3.0", body)})
    said = fmu_info(path)
    assert "\x9b" not in said and "\u202e" not in said
    assert r"ab\x9b31m\u202e forged line" in said
    long = foreign.description("3.0", variable(1).replace("quantity", "q" * 5000))
    assert " more characters)" in fmu_info(foreign.archive(tmp_path / "y.fmu", {MD: long}))
