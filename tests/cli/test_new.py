"""`phfmu new`: what it writes runs, is sound, passes its own test and replaces nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from phfmu.cli import main
from phfmu.target import functions
from tests.wide import wide


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def by_itself(folder: Path) -> subprocess.CompletedProcess[str]:
    """pytest by itself in the folder, as a user runs it."""
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "."]
    alone = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    alone["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # what else is installed here is none of its business
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, env=alone)


@pytest.mark.parametrize("kind", wide(["component", "scene"], "scene"))
def test_what_is_written_runs_and_passes_its_test(kind: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", kind, "my_part"]) == 0
    told = capsys.readouterr().out
    assert all(
        line in told for line in ("phfmu check my_part.py", "phfmu run my_part.py --plot", "pytest test_my_part.py")
    )
    assert functions(Path("my_part.py")) == ["my_part"] and "NAME" not in Path("my_part.py").read_text()
    assert main(["check", "--strict", "my_part.py"]) == 0
    assert main(["run", "my_part.py", "--engine", "python", "--step", "0.01"]) == 0
    assert "VIOLATED" not in capsys.readouterr().out
    done = by_itself(here)
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_the_test_notices_a_wrong_sign(here: Path) -> None:
    """Passing says something: a part that is changed without its solution fails."""
    assert main(["new", "component", "part"]) == 0
    file = Path("part.py")
    file.write_text(file.read_text().replace('parameter("k", 400.0', 'parameter("k", 390.0'))
    assert by_itself(here).returncode == 1


def test_nothing_is_replaced(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("test_tank.py").write_text("mine")
    assert main(["new", "component", "tank"]) == 2 and "test_tank.py would be replaced" in capsys.readouterr().err
    assert Path("test_tank.py").read_text() == "mine" and not Path("tank.py").exists()
    assert main(["new", "scene", "tank", "-o", "none"]) == 2 and "no such folder" in capsys.readouterr().err
    Path("other").mkdir()
    assert main(["new", "scene", "tank", "-o", "other"]) == 0 and Path("other/test_tank.py").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("my-part", "e.g. my_part"),
        ("2tank", "e.g. tank"),
        ("lambda", "no name of a function"),
        ("_hidden", "e.g. hidden"),
        ("json", "would hide from Python"),
        ("numpy", "would hide from Python"),
    ],
)
def test_names_that_cannot_be(name: str, words: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "component", name]) == 2 and words in capsys.readouterr().err
    assert not list(here.iterdir())
