"""Serialized states that somebody else wrote, with a checksum that fits: refused with a reason, or safe to go on from."""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path

import pytest

from phfmu import Scene, build_model, export
from phfmu.components.library import build
from phfmu.fmu.export import sources
from phfmu.fmu.export.schedule import UnitEvent
from phfmu.fmu.importer.archive import open_archive
from phfmu.schemes.collocated import Collocated
from tests.fmu.exported import SANITIZE
from tests.wide import longer

HERE = Path(__file__).parent
TRIALS = 2_000
#: scheme, step, inputs at nodes: with events, modes, the Schur stepper, values at nodes and impulses
MODELS = {
    "four_particle": (None, 0.01, False),
    "chain": (None, 0.01, False),
    "dc_motor": (Collocated(2), 1e-4, True),
    "flexible_shaft": (Collocated(2), 1e-3, True),
    "two_machine": (None, 1e-3, False),
    "bouncing_ball": (Collocated(2), 0.02, False),
    "bumper": (Collocated(2), 0.01, False),
    "clutch_engagement": (None, 0.01, False),
    "breaker_opening": (Collocated(2), 1e-4, False),
    "rectifier": (Collocated(2), 5e-4, False),
    "six_pulse": (None, 1e-4, False),
}
#: tried in FMI 2.0 too, which has the same states
BOTH = ("four_particle", "dc_motor", "bouncing_ball", "rectifier")


@pytest.mark.parametrize(
    ("name", "version"),
    longer(
        [*((n, "3.0") for n in MODELS), *((n, "2.0") for n in BOTH)],
        *(("dc_motor", "2.0"), ("four_particle", "3.0"), ("bouncing_ball", "3.0"), ("clutch_engagement", "3.0")),
        *(("breaker_opening", "3.0"), ("rectifier", "2.0")),
    ),
)
def test_forged_states(sanitizers: str, tmp_path: Path, name: str, version: str) -> None:
    scheme, step, nodes = MODELS[name]
    found = build(name)
    model = build_model(found.declaration() if isinstance(found, Scene) else found, scheme)
    events = [UnitEvent(e.t, e.name, e.value) for e in found.events] if isinstance(found, Scene) else []
    tunable = {e.name for e in events} & {n for v in model.declaration.parameters for n in v.names()}
    (path,) = export(model, tmp_path, (version,), step=step, node_inputs=nodes, events=events, tunable=tunable)
    about = open_archive(path).interface
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "unit")
    flags = ["-std=gnu11", "-O0", "-g", "-DPH_API=", f"-DFMI={version[0]}", "-isystem", str(sources.HEADERS), *SANITIZE]
    files = [*map(str, sorted((tmp_path / "unit" / "sources").glob("*.c"))), str(HERE / "forged_states.c")]
    subprocess.run([sanitizers, *flags, *files, "-o", "forge", "-lm"], cwd=tmp_path, check=True)
    references = [about.variables["time"].reference if version == "3.0" else 0]
    if about.derivatives and about.ports:
        port = about.ports[0]
        names = (
            (port.node_inputs[0][0], port.node_outputs[0][0]) if about.nodes else (port.inputs[0], port.step_outputs[0])
        )
        references += [about.variables[name].reference for name in names]
    command = ["./forge", about.token, str(TRIALS), "11", repr(step), str(len(about.variables)), *map(str, references)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, f"{done.returncode}: {done.stderr[-4000:]}"
    trials, refused, taken, stopped = map(int, done.stdout.split())
    print(
        f"{name} {version}: {trials} forged states, {refused} refused, {taken} taken, {stopped} steps from these refused"
    )
    assert trials == TRIALS and refused > 0 and taken > 0
