"""Hosts that keep to no rule, on units built with sanitizers: nothing is read outside its memory, no value is not finite."""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path

import pytest

from phfmu import Scene, build_model, export
from phfmu.components.library import build
from phfmu.fmu import sources
from phfmu.fmu.archive import open_archive
from phfmu.schemes.collocated import Collocated
from tests.fmu.exported import SANITIZE

HERE = Path(__file__).parent
#: what is called, in the order of the host
KINDS = (
    "instantiate free setup enter exit terminate reset get get set set step step step derivative save restore forget "
    "serialize deserialize logging others"
).split()
CALLS = 250_000
MODELS = {
    "dc_motor": (Collocated(2), 1e-4, True),
    "four_particle": (None, 0.01, False),
    "bouncing_ball": (Collocated(2), 0.02, False),
    "breaker_opening": (Collocated(2), 1e-4, False),
    "rectifier": (Collocated(2), 5e-4, False),
}


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("name", MODELS)
def test_calls_without_rules(sanitizers: str, tmp_path: Path, name: str, version: str) -> None:
    scheme, step, nodes = MODELS[name]
    found = build(name)
    model = build_model(found.declaration() if isinstance(found, Scene) else found, scheme)
    (path,) = export(model, tmp_path, (version,), step=step, node_inputs=nodes)
    about = open_archive(path).interface
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "unit")
    flags = ["-std=c11", "-O1", "-g", "-DPH_API=", f"-DFMI={version[0]}", "-isystem", str(sources.HEADERS), *SANITIZE]
    files = [*map(str, sorted((tmp_path / "unit" / "sources").glob("*.c"))), str(HERE / "fmu_fuzz.c")]
    subprocess.run([sanitizers, *flags, *files, "-o", "fuzz", "-lm"], cwd=tmp_path, check=True)
    command = ["./fuzz", about.token, str(CALLS), "7", repr(step), str(len(about.variables))]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, f"{done.returncode}: {done.stderr[-4000:]}"
    total, *rows = [line.split() for line in done.stdout.splitlines()]
    assert int(total[1]) == CALLS
    for kind, row in zip(KINDS, rows, strict=True):
        print(f"{name} {version} {kind:12s} called {row[1]:>8s} refused {row[2]:>8s}")
    accepted = {kind: 0 for kind in KINDS}
    for kind, row in zip(KINDS, rows, strict=True):
        accepted[kind] += int(row[1]) - int(row[2])
    idle = [kind for kind, n in accepted.items() if n == 0 and not (kind == "others" and version == "3.0")]
    assert not idle, "each kind of call gets through now and then"
