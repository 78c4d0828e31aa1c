"""The notebooks of the docs run from top to bottom; what they assert holds.  The site shows their results."""

from __future__ import annotations

import ast
import json
import re
import sys
import tomllib
from pathlib import Path

import pytest

from tests.wide import wide

ROOT = Path(__file__).parent.parent
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks() -> None:
    assert [p.stem for p in NOTEBOOKS] == ["generator", "own-component"]


def code(path: Path) -> list[str]:
    """The cells that run."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_the_extra_docs_brings_all_that_a_notebook_needs(path: Path) -> None:
    """The site runs the notebooks, in an environment that has this extra and nothing else."""
    text = "\n".join(code(path))
    parts = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Import | ast.ImportFrom)]
    named = [n.module or "" if isinstance(n, ast.ImportFrom) else n.names[0].name for n in parts]
    needed = {name.partition(".")[0] for name in named} - {"phfmu"} - set(sys.stdlib_module_names)
    needed |= {"pandas"} if ".to_pandas()" in text else set()
    needed |= {"ziglang"}  # NativeInstance and export compile
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    brought = [*project["dependencies"], *project["optional-dependencies"]["docs"]]
    assert needed <= {re.split(r"[<>=\[]", entry)[0] for entry in brought}


@pytest.mark.parametrize(
    "path", wide(NOTEBOOKS, *(p for p in NOTEBOOKS if p.stem == "own-component")), ids=lambda p: p.stem
)
def test_notebook_runs(compiler: None, path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    pytest.importorskip("pandas", reason="pandas is not installed")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") for cell in cells), "clear the outputs: the site makes them"
    space: dict[str, object] = {}
    for number, cell in enumerate(cells, 1):
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{path.name}, cell {number}", "exec"), space)
