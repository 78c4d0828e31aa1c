"""The notebooks of the docs run from top to bottom; what they assert holds.  The site shows their results."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.wide import wide

NOTEBOOKS = sorted((Path(__file__).parent.parent / "docs" / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks() -> None:
    assert [p.stem for p in NOTEBOOKS] == ["generator", "own-component"]


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
