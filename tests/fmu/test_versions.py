"""FMI versions are rows: nothing else asks which version it has, and a row carries all that differs."""

from __future__ import annotations

import ast
import zipfile
from pathlib import Path

import fmpy
import pytest

from phfmu import build_model
from phfmu.components.mechanical.translational import mass
from phfmu.fmu.export import sources
from phfmu.fmu.export import variables as fmu_variables
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.importer.archive import Archive
from phfmu.fmu.importer.model_description import read_interface
from phfmu.fmu.version import FMI2, FMI3, VERSIONS, Names, written_by

PACKAGE = Path(fmu_variables.__file__).parents[1]
NUMBERS = {"2.0", "3.0", "fmi2", "fmi3"}


def asked(path: Path) -> list[int]:
    """Lines that compare with a version, or have a table by versions."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    places = [(n.lineno, (n.left, *n.comparators)) for n in nodes if isinstance(n, ast.Compare)]
    places += [(n.lineno, n.keys) for n in nodes if isinstance(n, ast.Dict)]
    return [line for line, parts in places if any(isinstance(p, ast.Constant) and p.value in NUMBERS for p in parts)]


def test_nothing_but_the_row_knows_a_version() -> None:
    found = {p.name: asked(p) for room in ("fmu", "cli", "network") for p in (PACKAGE / room).rglob("*.py")}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_every_c_file_of_the_interface_belongs_to_all_or_to_one_row() -> None:
    layers = [name for row in VERSIONS.values() for name in row.layers]
    assert len(layers) == len(set(layers))
    there = {p.name for p in sources.RUNTIME.iterdir() if p.name.startswith("fmi")}
    assert there == set(layers)


@pytest.mark.parametrize("row", VERSIONS.values(), ids=list(VERSIONS))
def test_a_file_of_names_has_what_a_version_needs(row) -> None:
    functions = {n for n in vars(Names) if not n.startswith("_")}
    assert functions and all(callable(getattr(row.code, n)) for n in functions)


def test_documents_find_their_row() -> None:
    assert [written_by(text) for text in ("2.0", "3.0", "3.0.1", "3.1")] == [FMI2, FMI3, FMI3, FMI3]
    assert all(written_by(text) is None for text in ("", "1.0", "2.0.1", "2", "3", "30", "4.0"))


@pytest.mark.parametrize("row", VERSIONS.values(), ids=list(VERSIONS))
def test_a_description_is_read_as_its_row_writes_it(row, tmp_path: Path) -> None:
    """Words of the row in both directions: token, abilities, types and starts come back."""
    unit = ExportedUnit(build_model(mass(2.0, k=100.0, q=0.1)), 1e-2)
    path = tmp_path / "d.xml"
    path.write_bytes(row.description(unit, "{token}"))
    with path.open("rb") as stream:
        about = read_interface(stream, None, "mass.fmu")
    assert (about.version, about.token, about.saves, about.derivatives) == (row.number, "{token}", True, True)
    starts = {v.name: v.start for v in unit.variables if v.name != "time"}
    assert {n: v.start for n, v in about.variables.items() if n != "time"} == starts
    assert {v.type for v in about.variables.values()} == {"Float64"}


@pytest.mark.parametrize(
    ("platform", "names", "expected"),
    [
        ("aarch64-linux", ("linux64", "aarch64-linux"), "aarch64-linux"),  # linux64 is another processor's
        ("aarch64-darwin", ("darwin64",), "darwin64"),  # a universal library
        ("x86_64-linux", ("linux64", "x86_64-linux"), "linux64"),
        ("x86-linux", ("linux32",), "linux32"),
    ],
)
def test_the_library_of_this_machine_is_found(platform, names, expected, tmp_path, monkeypatch) -> None:
    """Also where FMI 2.0 has no name for it and several folders could be meant."""
    path = tmp_path / "mass.fmu"
    unit = ExportedUnit(build_model(mass(2.0, k=100.0)), 1e-2)
    ending = fmpy.sharedLibraryExtension
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", FMI2.description(unit, "{token}"))
        for name in names:
            archive.writestr(f"binaries/{name}/mass{ending}", b"")
    monkeypatch.setattr(fmpy, "platform_tuple", platform)
    monkeypatch.setattr(fmpy, "platform", "linux64" if "linux" in platform else "darwin64")
    if platform == "x86-linux":
        monkeypatch.setattr(fmpy, "platform", "linux32")
    assert Archive(path).library == f"binaries/{expected}/mass{ending}"
