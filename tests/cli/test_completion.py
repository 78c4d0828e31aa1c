"""TAB: verbs, options and targets, as the shell asks for them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from phfmu.cli import main
from phfmu.cli.verbs.completion import SHELLS, targets
from phfmu.components.library import LIBRARY

CALL = "import sys; sys.argv[0] = 'phfmu'; from phfmu.cli import main; raise SystemExit(main())"


def answered(line: str, folder: Path) -> list[str]:
    """What a shell gets for this line."""
    answer = folder / "answer"
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_SHELL": "bash", "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
             "_ARGCOMPLETE_COMP_WORDBREAKS": " \t\n\"'><=;|&(:", "_ARGCOMPLETE_IFS": "\n", "COMP_LINE": line,
             "COMP_POINT": str(len(line)), "COMP_TYPE": "9"}  # fmt: skip
    subprocess.run([sys.executable, "-c", CALL], cwd=folder, env={**os.environ, **asked}, check=True)
    return [word.strip() for word in answer.read_text().split("\n")]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("phfmu com", ["compare", "completion"]),
        ("phfmu run oscil", ["oscillator"]),
        ("phfmu run smib --eng", ["--engine"]),
        ("phfmu run smib --engine ", ["auto", "python", "native", "fmu"]),
        ("phfmu check tank.py:", ["tank", "basin"]),
    ],
)
def test_a_line_is_completed(line: str, words: list[str], tmp_path: Path) -> None:
    (tmp_path / "tank.py").write_text("def tank(): ...\ndef basin(n=2): ...\ndef needs(n): ...\n")
    assert answered(line, tmp_path) == words


def test_targets_are_names_and_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("smile.py", "smooth.fmu", "small.txt"):
        Path(name).touch()
    assert set(targets("sm")) == {n for n in LIBRARY if n.startswith("sm")} | {"smile.py", "smooth.fmu"}
    assert set(targets("dc_m")) == {"dc_motor"}
    assert targets("none.py:") == []


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_gets_its_code(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0 and "phfmu" in capsys.readouterr().out


def test_help_loads_neither_numpy_nor_what_completes() -> None:
    loaded = "{'numpy', 'casadi', 'argcomplete'} & {*sys.modules}"
    program = f"import sys, atexit; atexit.register(lambda: print({loaded})); {CALL}"
    said = subprocess.run([sys.executable, "-c", program, "--help"], capture_output=True, text=True, check=True).stdout
    assert said.strip().endswith("set()") and "completion" in said
