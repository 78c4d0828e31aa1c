"""The README keeps its word: its Python blocks and its commands run, in order, in one folder.

Rules:  ```python blocks share one namespace; a block whose first line is `# name.py` is also saved under that name.
        ```console blocks hold lines `$ phfmu ...`; each must end with exit code 0.
        ```bash blocks are set-up commands that change the machine (`python3 -m venv ...`) and are not run.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from phfmu.cli import main
from phfmu.engine.compile import CompilerMissing, require_compiler

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(language: str) -> list[str]:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return [body for name, body in BLOCK.findall(text) if name == language]


def commands() -> list[str]:
    lines = [line for body in blocks("console") for line in body.splitlines()]
    return [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    try:
        require_compiler()
    except CompilerMissing as error:
        pytest.skip(str(error))
    return tmp_path_factory.mktemp("readme")


@pytest.fixture(scope="module")
def session(folder: Path) -> dict[str, object]:
    """The Python blocks, run one after the other."""
    namespace: dict[str, object] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for number, body in enumerate(blocks("python"), 1):
            first = body.splitlines()[0]
            if re.fullmatch(r"# \w+\.py", first):
                (folder / first.removeprefix("# ")).write_text(body, encoding="utf-8")
            exec(compile(body, f"README.md, Python block {number}", "exec"), namespace)
    return namespace


def test_readme_python_blocks_run(session: dict[str, object]) -> None:
    assert "result" in session and "rows" in session


def test_readme_commands_end_well(
    session: dict[str, object], folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    assert len(commands()) > 5
    for command in commands():
        program, *arguments = shlex.split(command)
        assert program == "phfmu", command
        assert main(arguments) == 0, f"{command}\n{capsys.readouterr().err}"


def test_setup_commands_are_the_only_blocks_not_run() -> None:
    known = {"python", "console", "bash"}
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert {name for name, _ in BLOCK.findall(text)} <= known
    assert all(body.startswith("python3 -m venv ") for body in blocks("bash"))


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
