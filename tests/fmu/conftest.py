"""What several files of this folder ask for."""

from __future__ import annotations

from pathlib import Path

import pytest

from phfmu import PHDAE, export
from phfmu.discretise.model import Model
from tests.fmu.exported import build


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
