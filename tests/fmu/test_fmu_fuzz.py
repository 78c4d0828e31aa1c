"""Hosts that keep to no rule, on units built with sanitizers: nothing is read outside its memory, no value is not finite."""

from __future__ import annotations

import subprocess
import zipfile
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from phfmu import Scene, build_model, export
from phfmu.components.library import build
from phfmu.fmu.export import sources
from phfmu.fmu.importer.archive import open_archive
from phfmu.network.as_unit.export import export_network
from phfmu.schemes.collocated import Collocated
from tests.fmu.exported import SANITIZE
from tests.wide import longer

HERE = Path(__file__).parent
#: what is called, in the order of the host
KINDS = (
    "instantiate free setup enter exit terminate reset get get set set step step step derivative save restore forget "
    "serialize deserialize logging others"
).split()

#: scheme, step, inputs at nodes, and how many calls of a simulation there are beside each that is any
MODELS = {
    "dc_motor": (Collocated(2), 1e-4, True, 0),
    "four_particle": (None, 0.01, False, 0),
    "bouncing_ball": (Collocated(2), 0.02, False, 0),
    "breaker_opening": (Collocated(2), 1e-4, False, 0),
    "rectifier": (Collocated(2), 5e-4, False, 0),
}
#: with modes of ideal switches: they change only in units that live for some time
SWITCHED = {
    ("rectifier", "2.0"): (Collocated(2), 5e-4, False, 8),
    ("buck", "3.0"): (Collocated(1), 5e-6, False, 8),
    ("hard_stop", "3.0"): (Collocated(1), 0.01, False, 8),
}
#: seeds, and calls of each
RUNS = {0: ((7,), 250_000), 8: ((1, 2), 100_000)}


@pytest.mark.parametrize(
    ("name", "version"),
    longer(
        product(MODELS, ("2.0", "3.0")),
        ("dc_motor", "2.0"),
        ("bouncing_ball", "3.0"),
        ("four_particle", "3.0"),
        ("rectifier", "2.0"),
    ),
)
def test_calls_without_rules(sanitizers: str, tmp_path: Path, name: str, version: str) -> None:
    accepted = called(sanitizers, tmp_path, (name, version), MODELS[name])
    idle = [kind for kind, n in accepted.items() if n == 0 and not (kind == "others" and version == "3.0")]
    assert not idle, "each kind of call gets through now and then"


@pytest.mark.parametrize(("name", "version"), longer(SWITCHED, ("buck", "3.0")))
def test_calls_without_rules_between_those_of_simulations(
    sanitizers: str, tmp_path: Path, name: str, version: str
) -> None:
    """Units with ideal switches, which step on in between, so that their modes change, are saved, restored and refused."""
    accepted = called(sanitizers, tmp_path, (name, version), SWITCHED[name, version])
    assert accepted["step"] > 3000, "steps get through"


@pytest.mark.parametrize(
    ("name", "version"),
    longer(
        [
            ("oscillator", "2.0"),
            ("speed_control", "3.0"),
            ("smib", "2.0"),
            ("rectifier", "3.0"),
            ("clutch_engagement", "2.0"),
        ],
        ("speed_control", "3.0"),
    ),
)
def test_calls_without_rules_of_coupled_members(sanitizers: str, tmp_path: Path, name: str, version: str) -> None:
    scene = build(name)
    schemes = dict.fromkeys(scene.system.declared, Collocated(2))
    for lively in (0, 8):
        folder = tmp_path / str(lively)
        (path,) = export_network(scene.system, folder, schemes, (version,), step=scene.step)
        accepted = answered(sanitizers, folder, path, version, scene.step, lively)
        assert accepted["step"] > 0 and accepted["restore"] > 0


def called(sanitizers: str, tmp_path: Path, unit: tuple[str, str], how: tuple[Any, float, bool, int]) -> dict[str, int]:
    """As `answered`, for a model of the library."""
    (name, version), (scheme, step, nodes, lively) = unit, how
    found = build(name)
    model = build_model(found.declaration() if isinstance(found, Scene) else found, scheme)
    (path,) = export(model, tmp_path, (version,), step=step, node_inputs=nodes)
    return answered(sanitizers, tmp_path, path, version, step, lively)


def answered(sanitizers: str, tmp_path: Path, path: Path, version: str, step: float, lively: int) -> dict[str, int]:
    """How many calls of each kind were accepted, printed; fails if one read outside of its memory or gave what is not finite."""
    about = open_archive(path).interface
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "unit")
    flags = ["-std=c11", "-O1", "-g", "-DPH_API=", f"-DFMI={version[0]}", "-isystem", str(sources.HEADERS), *SANITIZE]
    files = [*map(str, sorted((tmp_path / "unit" / "sources").glob("*.c"))), str(HERE / "fmu_fuzz.c")]
    subprocess.run([sanitizers, *flags, *files, "-o", "fuzz", "-lm"], cwd=tmp_path, check=True)
    accepted = {kind: 0 for kind in KINDS}
    seeds, calls = RUNS[lively]
    for seed in seeds:
        command = ["./fuzz", about.token, str(calls), str(seed), repr(step), str(len(about.variables)), str(lively)]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, f"seed {seed}: {done.returncode}: {done.stderr[-4000:]}"
        total, *rows = [line.split() for line in done.stdout.splitlines()]
        assert int(total[1]) == calls
        for kind, row in zip(KINDS, rows, strict=True):
            print(f"{path.stem} seed {seed} {kind:12s} called {row[1]:>8s} refused {row[2]:>8s}")
            accepted[kind] += int(row[1]) - int(row[2])
    print(f"{path.stem}: {len(seeds) * calls} calls, {accepted['step']} steps accepted")
    return accepted
