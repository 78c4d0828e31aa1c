"""Packages of SSP for the tests: written by this package, and by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from phfmu import build_model, export
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass, spring


@pytest.fixture(scope="session")
def units(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """mass.fmu (a moving mass) and spring.fmu, FMI 2.0, as files of a package."""
    folder = tmp_path_factory.mktemp("units")
    made = {}
    for name, declaration in (("mass", mass(2.0, v=1.0)), ("spring", spring(40.0))):
        (path,) = export(build_model(declaration), folder, ("2.0",), step=1e-2)
        made[f"resources/{name}.fmu"] = path.read_bytes()
    return made


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Version of SSP -> the scene `oscillator` as a package; 2.0 with units of FMI 3.0."""
    made = {}
    for version, fmi in (("1.0", "2"), ("2.0", "3")):
        folder = tmp_path_factory.mktemp(f"ssp{version[0]}")
        assert main(["export", "oscillator", "--ssp", version, "--fmi", fmi, "-o", str(folder)]) == 0
        made[version] = folder / "oscillator.ssp"
    return made
