"""Files as targets: modules beside them are found, and nothing of theirs stays behind."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from phfmu.cli import main
from phfmu.target import TargetError, load

USES = """
from numbers_beside import MASS
from phfmu.components.mechanical.translational import mass


def part():
    from parts_beside.more import half
    return mass(half(MASS))
"""


def written(folder: Path, value: float) -> str:
    (folder / "parts_beside").mkdir(parents=True)
    (folder / "parts_beside" / "__init__.py").touch()
    (folder / "parts_beside" / "more.py").write_text("def half(x):\n    return x / 2\n")
    (folder / "numbers_beside.py").write_text(f"MASS = {value}\n")
    (folder / "part.py").write_text(USES)
    return f"{folder / 'part.py'}:part"


def test_modules_beside_a_file_are_those_of_its_own_folder(tmp_path: Path) -> None:
    path, modules = list(sys.path), set(sys.modules)
    for folder, value in (("one", 4.0), ("two", 6.0)):
        found = load(written(tmp_path / folder, value))
        assert found.parameters[0].start == (value / 2,)
    assert sys.path == path
    assert not {n for n in set(sys.modules) - modules if n.partition(".")[0] in ("numbers_beside", "parts_beside")}


def test_a_file_that_changes_is_read_again(tmp_path: Path) -> None:
    target = written(tmp_path / "one", 4.0)
    load(target)
    (tmp_path / "one" / "numbers_beside.py").write_text("MASS = 100.0\n")
    assert load(target).parameters[0].start == (50.0,)


def test_modules_of_python_and_of_packages_win(tmp_path: Path) -> None:
    """A file called numpy.py or json.py beside a target does not take the place of the module."""
    target = written(tmp_path / "one", 4.0)
    for name in ("colorsys", "numpy"):
        (tmp_path / "one" / f"{name}.py").write_text("raise SystemExit('hidden')\n")
    text = (tmp_path / "one" / "part.py").read_text()
    (tmp_path / "one" / "part.py").write_text(f"import colorsys, numpy\n{text}")
    assert load(target).parameters[0].start == (2.0,)


def test_a_module_that_is_nowhere_is_told_with_its_line(tmp_path: Path) -> None:
    target = written(tmp_path / "one", 4.0)
    (tmp_path / "one" / "numbers_beside.py").unlink()
    with pytest.raises(TargetError, match="part.py, line 2: ModuleNotFoundError: No module named 'numbers_beside'"):
        load(target)


@pytest.mark.parametrize(
    "line",
    [
        "info {}",
        "check --strict {}",
        "run {} --engine python --stop 0.01 --quiet",
        "sweep {} --vary m=1,2 --measure max(v) --engine python --stop 0.01 --quiet",
    ],
)
def test_verbs_find_them_from_another_folder(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = written(tmp_path / "one", 4.0)
    monkeypatch.chdir(tmp_path)
    assert main(line.format(target).split()) == 0


# -- arguments -----------------------------------------------------------------------------------------------------------


def test_names_and_functions_take_arguments(tmp_path: Path) -> None:
    assert [p.start for p in load("mass(2, k=40.0)").parameters] == [(2.0,), (40.0,)]
    assert load("rl_line(L=2e-3)").parameters[0].start == (0.02,)  # the example's where it has no default
    folder = tmp_path / "a:b (1)"
    folder.mkdir()
    (folder / "two.py").write_text(
        "from phfmu.components.mechanical import mass\n\n\ndef two(m=1.0, label='x:y'):\n    assert label\n    return mass(m)\n"
    )
    assert load(f"{folder / 'two.py'}:two(m=3.0, label='p:q(r)')").parameters[0].start == (3.0,)
    assert load(f"{folder / 'two.py'}:two").parameters[0].start == (1.0,)


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("mass(q0=1)", r"unexpected keyword argument 'q0'; it is mass\(m=1.0, \*, k=None, d=None, q=0.0, v=0.0\)"),
        ("mass(1, m=2)", "multiple values for argument 'm'"),
        ("mass(k=", "cannot be read; write NAME"),
        ("mass(k=open('x'))", "cannot be read; write NAME"),
    ],
)
def test_arguments_that_do_not_fit_are_told(target: str, words: str) -> None:
    with pytest.raises(TargetError, match=words):
        load(target)


def told(target: str, capsys: pytest.CaptureFixture[str]) -> dict[str, list[str]]:
    """The lines of the arguments in `phfmu info`, by name."""
    assert main(["info", target]) == 0
    lines = iter(capsys.readouterr().out.splitlines())
    head = next(line for line in lines if line.startswith("arguments"))
    rows = {}
    for line in lines:
        if not line.startswith("  "):
            break
        rows[line.split()[0]] = line.split(maxsplit=3)[1:]
    return {"": [head], **rows}


def test_info_lists_the_arguments_with_units_values_and_what_is_optional(capsys: pytest.CaptureFixture[str]) -> None:
    found = told("mass(d=0.5)", capsys)
    assert found[""] == ["arguments (phfmu run 'mass(m=..)'; in Python: from phfmu.components.mechanical import mass):"]
    assert found["k"] == ["N/m", "None", "optional, absent unless given"]
    assert found["d"][:2] == ["N.s/m", "0.5"] and found["q"] == ["m", "0.0"]
    assert told("clearing_fault", capsys)["there"] == [
        "True",
        "False",
        "by default",
    ]  # the library shows it where it is there
    assert told("infinite_bus", capsys)["frequency"] == ["Hz", "60.0"]
    assert told("rl_line", capsys)["R"] == ["ohm", "0.02", "resistance per phase; must be given in Python"]


def test_every_number_that_the_library_takes_has_a_unit() -> None:
    from functools import partial
    from inspect import signature

    from phfmu.arguments import arguments
    from phfmu.components.library import LIBRARY, build, builder

    for name in LIBRARY:
        kinds = {p.name: str(p.annotation) for p in signature(builder(name)).parameters.values()}
        for a in arguments(builder(name), partial(build, name), {}):
            assert a.unit or not ("float" in kinds[a.name] or "Phases" in kinds[a.name]), f"{name}({a.name}=)"
