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
