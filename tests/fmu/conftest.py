"""What several files of this folder ask for."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from phfmu import PHDAE, export
from phfmu.discretise.model import Model
from tests.fmu.exported import SANITIZE, build


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory):
    """name -> (declaration, model, step, {version: path}); every unit is written once."""
    made: dict[str, tuple[PHDAE, Model, float, dict[str, Path]]] = {}

    def get(name: str):
        if name not in made:
            declaration, model, step = build(name)
            paths = export(model, tmp_path_factory.mktemp(name), step=step, stop=100 * step)
            made[name] = declaration, model, step, dict(zip(("2.0", "3.0"), paths, strict=True))
        return made[name]

    return get


@pytest.fixture(scope="session")
def sanitizers(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A C compiler whose sanitizers link and run; else the test is skipped with the reason."""
    folder = tmp_path_factory.mktemp("probe")
    (folder / "probe.c").write_text("int main(void) { return 0; }\n")
    for name in ("gcc", "clang", "cc"):
        if not (compiler := shutil.which(name)):
            continue
        made = subprocess.run([compiler, *SANITIZE, "probe.c", "-o", "probe"], cwd=folder, capture_output=True)
        if made.returncode == 0 and subprocess.run([folder / "probe"], capture_output=True).returncode == 0:
            return compiler
    pytest.skip("no C compiler here links the address and undefined behaviour sanitizers")
