"""What an export can leave out or move, what it says about it, and names that are no good C, XML or HTML."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from lxml import etree

from phfmu import PHDAE, Event, Scene, build_model, energy, export, parameter, state
from phfmu.cli import main
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.translational import mass
from phfmu.fmu.export.manifest import PATH
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.fmu.words import c_comment, c_string
from phfmu.network.members.fmu_member import FMUMember

VERSIONS = ["2.0", "3.0"]
PAGE = "documentation/index.html"


def pushed() -> Scene:
    """A scene with an event of each kind and damping steps."""
    events = (Event(0.2, "flange.force", 3.0), Event(0.4, "k", 90.0))
    return Scene("pushed", mass(2.0, k=100.0, d=0.5, q=0.1), 1.0, 1e-2, events, restart=2)


def entry(path: Path, name: str) -> bytes:
    return zipfile.ZipFile(path).read(name)


def test_events_that_are_left_out_are_said_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.py").write_text("from tests.fmu.test_fmu_options import pushed\n")
    assert main(["export", "s.py:pushed"]) == 0
    said = capsys.readouterr()
    lines = [
        "event at t = 0.2 s, flange.force = 3: set this input at that time",
        "event at t = 0.4 s, k = 90: set this tunable parameter at that time",
        "2 damping steps after each event",
    ]
    assert said.err.splitlines() == [f"phfmu: not in the unit: {line}" for line in lines]
    assert all(Path(p).is_file() for p in said.out.splitlines())
    for path in said.out.splitlines():
        assert validate_fmu(path) == []
        page = entry(Path(path), PAGE).decode()
        assert all(f"<li>{line}</li>" in page for line in lines)
        found = etree.fromstring(entry(Path(path), PATH)).findall("LeftOut")
        assert [e.get("what") for e in found] == lines
    assert main(["export", "mass", "--fmi", "2"]) == 0
    assert capsys.readouterr().err == "" and b"leaves out" not in entry(Path("mass_fmi2.fmu"), PAGE)


@pytest.fixture(scope="module")
def ways(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Path]]:
    """{ledger | local: {version: path}} of a mass, the second without terminals."""
    declaration = mass(2.0, k=100.0, d=0.5, q=0.1)
    model, made = build_model(declaration), {}
    for name, more in (("ledger", {}), ("local", {"ledger_outputs": False, "terminals": False})):
        paths = export(model, tmp_path_factory.mktemp(name), step=1e-2, **more)
        made[name] = dict(zip(VERSIONS, paths, strict=True))
    return made


@pytest.mark.parametrize("version", VERSIONS)
def test_the_ledger_can_be_local(ways: dict[str, dict[str, Path]], version: str) -> None:
    """What one connects stays an output: values now and step means.  Values and ledger of a run are the same bits."""
    path = ways["local"][version]
    assert validate_fmu(str(path)) == []
    about = read_model_description(str(path))
    outputs = {v.name for v in about.modelVariables if v.causality == "output"}
    assert outputs == {"flange.velocity", "flange.velocity_step"}
    assert {u.variable.name for u in about.initialUnknowns} == outputs
    with FMUInstance(path) as one, FMUInstance(ways["ledger"][version]) as two:
        assert "flange.energy" in [n for n, v in two.interface.variables.items() if v.causality == "output"]
        members = [FMUMember("m", one), FMUMember("m", two)]
        assert members[0].names == members[1].names and members[0].booking == members[1].booking
        for k in range(20):
            for m in members:
                m.set_input(np.array([np.sin(k)]))
                m.do_step(k * 1e-2, 1e-2)
            np.testing.assert_array_equal(members[0].read(), members[1].read())
            for name, value in members[0].ledger().items():
                np.testing.assert_array_equal(value, members[1].ledger()[name])


def test_residuals_of_constraints_are_local_then_too(tmp_path: Path) -> None:
    declaration = four_particle()
    (path,) = export(build_model(declaration), tmp_path, ("3.0",), step=0.01, ledger_outputs=False)
    variables = read_model_description(str(path)).modelVariables
    assert not [v.name for v in variables if v.causality == "output"]
    assert [v.causality for v in variables if v.name.startswith("constraint.")] == ["local"] * 4
    with pytest.raises(RuntimeError, match="inconsistent: constraint.velocity"):
        FMUInstance(path, starts={"v[4]": 0.3})


@pytest.mark.parametrize("version", VERSIONS)
def test_terminals_can_be_left_out(ways: dict[str, dict[str, Path]], version: str) -> None:
    def with_terminals(way: str) -> bool:
        return any(n.startswith("terminalsAndIcons") for n in zipfile.ZipFile(ways[way][version]).namelist())

    assert with_terminals("ledger") and not with_terminals("local")


def test_the_command_line_knows_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["export", "mass", "--fmi", "2", "--outputs", "local", "--no-terminals", "-o", str(tmp_path)]
    assert main(line) == 0
    path = Path(capsys.readouterr().out.strip())
    assert not [n for n in zipfile.ZipFile(path).namelist() if n.startswith("terminals")]
    outputs = [v.name for v in read_model_description(str(path)).modelVariables if v.causality == "output"]
    assert outputs and not [n for n in outputs if "energy" in n]


NASTY = 'a*/ int x = 1; /* "quoted" \\ ??/ <b>&amp; \x1b[31m\nend %s %n'


@pytest.mark.usefixtures("compiler")
def test_names_that_end_comments_and_strings_do_no_harm(tmp_path: Path) -> None:
    q, c = state("q", unit="m", start=1.0, description=NASTY), parameter("c", 2.0, description=NASTY)
    declaration = PHDAE(NASTY, states=(q,), parameters=(c,), energies=(energy(0.5 * c * q**2),), description=NASTY)
    for path in export(build_model(declaration), tmp_path, step=0.1, left_out=[NASTY]):
        assert validate_fmu(str(path)) == []
        shown = NASTY.replace("\x1b", r"\x1b").replace("\n", " ")
        about = read_model_description(str(path))
        assert about.modelName == about.description == shown
        assert next(v for v in about.modelVariables if v.name == "q").description == shown
        page = entry(path, PAGE).decode()
        assert "<b>" not in page and "&lt;b&gt;&amp;amp;" in page
        code = entry(path, "sources/interface.c").decode()
        assert "a* / int x = 1; / * " in code and "\x1b" not in code
        with FMUInstance(path) as unit:
            unit.do_step(0.0, 0.1)


def test_c_text_reads_back() -> None:
    """Strings and comments, without a compiler: what C makes of the escapes is the text again."""
    text = c_string(NASTY)
    body = text[1:-1].replace("\\?", "?")
    assert text[0] == text[-1] == '"' and body.encode().decode("unicode_escape") == NASTY
    assert "??" not in text and "\n" not in text
    assert "*/" not in c_comment("*/*/ **//") and "/*" not in c_comment("/*/*/")
