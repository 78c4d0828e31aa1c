"""What several files of this folder ask for."""

from __future__ import annotations

from pathlib import Path

import pytest

from phfmu import export
from tests.schemes.body_and_spring import plan


@pytest.fixture(scope="module")
def units(tmp_path_factory):
    """(name, k, version) -> path of a unit with node inputs, step 0.1 s."""
    made: dict[tuple[str, int, int | None], dict[str, Path]] = {}

    def get(name: str, k: int, version: str, size: int | None = None) -> Path:
        if (name, k, size) not in made:
            model, folder = plan(name, k, size), tmp_path_factory.mktemp(name)
            paths = export(model, folder, step=0.1, node_inputs=True)
            made[name, k, size] = dict(zip(("2.0", "3.0"), paths, strict=True))
        return made[name, k, size][version]

    return get
