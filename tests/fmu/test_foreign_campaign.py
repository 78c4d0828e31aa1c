"""Units of other tools alone and in every coupling, FMI 2.0 and 3.0, against known answers, with the number of runs."""

from __future__ import annotations

import shutil
import zipfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import export
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.discretise.model import build_model
from tests.fmu import foreign
from tests.fmu.public_units import public

VERSIONS = ["2.0", "3.0"]
COUPLINGS = ["newton", "anderson", "gauss-seidel", "jacobi"]
#: of a mass that is made by hand: what is set, and what its archive is like
KINDS: dict[str, tuple[dict[str, int], dict[str, Any]]] = {
    "usual": ({}, {}),
    "begins at the last point told True": ({"keeps": 1}, {}),
    "stays under False": ({"keeps": 2}, {}),
    "restores nothing after True": ({"keeps": 3}, {}),
    "stays, and restores nothing": ({"keeps": 4}, {}),
    "cannot save": ({}, {"saves": False}),
    "forgets its position": ({"forgets": 1}, {}),
    "forgets all": ({"forgets": 2}, {}),
    "refuses to save": ({"forgets": 3}, {}),
    "lacks functions": ({}, {"lacks": ["fmi2Terminate", "fmi3Terminate", "fmi2SetFMUstate", "fmi3SetFMUState"]}),
    "steps of one length": ({}, {"abilities": 'canHandleVariableCommunicationStepSize="false"'}),
    "one in a process": ({}, {"abilities": 'canBeInstantiatedOnlyOncePerProcess="true"'}),
    "claims derivatives": (
        {},
        {"abilities": 'providesDirectionalDerivative="true" providesDirectionalDerivatives="true"'},
    ),
}
SCENE = """
from phfmu import Network, Scene
from phfmu.components.mechanical.translational import spring


def joined():
    net = Network("joined")
    net.add("pump", "pump.fmu", ports={"flange": {"effort": "F", "flow": "v", "sign": 1, "displacement": "q"}})
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    return Scene("joined", net, stop=1.0, step=0.005)
"""
W = np.sqrt(40.0)
#: most that v may be off a swing of 1.9 m/s over a second in steps of 5 ms: of second order; of first order, with its growth
NEAR = {"newton": 2e-3, "anderson": 2e-3, "gauss-seidel": 0.05, "jacobi": 0.3}


def table(out: Path, *options: str) -> np.ndarray:
    assert main(["run", *options, "--quiet", "-o", str(out)]) == 0, options
    return np.atleast_1d(np.genfromtxt(out, delimiter=",", names=True, deletechars=""))


@pytest.mark.slow
def test_masses_made_by_hand(tmp_path: Path) -> None:
    """On a spring of its own q = 0.3 cos(w t); on a spring beside it v = -0.3 w sin(w t), of which it is pulled."""
    (tmp_path / "joined.py").write_text(SCENE)
    counts, out = Counter[str](), tmp_path / "o.csv"
    for version in VERSIONS:
        for name, (given, archive) in KINDS.items():
            unit = foreign.mass(tmp_path / "pump.fmu", version, **archive)
            options = [f"--set={n}={value}" for n, value in given.items()]
            for isolate in ([], ["--isolate"]):
                rows = table(out, str(unit), "--set=k=40", "--set=q=0.3", "--step=0.05", *options, *isolate)
                assert np.abs(rows["q"] - 0.3 * np.cos(W * rows["time"])).max() < 1e-12, (version, name)
                counts["alone"] += 1
            for coupling in COUPLINGS:
                own = [f"--set=pump.{o.removeprefix('--set=')}" for o in options]
                rows = table(out, str(tmp_path / "joined.py"), "--coupling", coupling, *own)
                swing = np.abs(np.abs(rows["pump.v"]) - np.abs(0.3 * W * np.sin(W * rows["time"]))).max()
                assert len(rows) == 201 and swing < NEAR[coupling], (version, name, coupling, swing)
                counts[coupling] += 1
    print(dict(counts))
    assert counts == {"alone": 4 * len(KINDS), **dict.fromkeys(COUPLINGS, 2 * len(KINDS))}


MOTOR = """
from phfmu import Network, Scene
from phfmu.components.mechanical.rotational import flexible_shaft, rotational_inertia


def rig():
    net = Network("rig")
    net.add("motor", "motor.fmu", ports={"shaft": {"effort": "shaft.torque", "flow": "shaft.speed", "sign": 1}})
    net.add("shaft", flexible_shaft(20.0, d=1e-3, twist=1e-3))
    net.add("wheel", rotational_inertia(1e-4))
    net.connect("motor.shaft", "shaft.a", name="near")
    net.connect("wheel.a", "shaft.b", name="far")
    return Scene("rig", net, stop=0.02, step=2e-5)
"""


@pytest.mark.slow
@pytest.mark.usefixtures("compiler")
def test_units_of_this_package_as_those_of_another_tool(tmp_path: Path) -> None:
    """A motor without its manifest, in all couplings, against its declaration in the composed model."""
    from phfmu import Monolithic, NativeInstance, Network, Options, run
    from phfmu.components.mechanical.rotational import flexible_shaft, rotational_inertia

    motor = build("dc_motor")
    net = Network("rig")
    net.add("motor", motor)
    net.add("shaft", flexible_shaft(20.0, d=1e-3, twist=1e-3))
    net.add("wheel", rotational_inertia(1e-4))
    net.connect("motor.shaft", "shaft.a", name="near")
    net.connect("wheel.a", "shaft.b", name="far")
    model = build_model(net.compose())
    whole = Monolithic(model, NativeInstance(model))
    whole.set_value("motor.terminal.v", 12.0)
    truth = run(whole, Options(stop=0.02, step=2e-6))
    (tmp_path / "rig.py").write_text(MOTOR)
    counts = Counter[str]()
    for version in VERSIONS:
        (ours,) = export(build_model(motor), tmp_path / "ours", (version,), step=2e-5)
        with zipfile.ZipFile(ours) as archive, zipfile.ZipFile(tmp_path / "motor.fmu", "w") as theirs:
            for name in archive.namelist():
                if not name.startswith(("extra/", "terminalsAndIcons/")):
                    theirs.writestr(name, archive.read(name))
        for coupling in COUPLINGS:
            rows = table(tmp_path / "o.csv", f"{tmp_path}/rig.py", "--set=motor.terminal.v=12", "--coupling", coupling)
            for name in ("motor.w", "shaft.twist"):
                expected = truth.column(name)[-1]
                near = 1e-4 if coupling in ("newton", "anderson") else 1e-2
                scale = np.abs(truth.column(name)).max()
                assert abs(rows[name][-1] - expected) < near * scale, (version, coupling, name)
            counts[coupling] += 1
    print(dict(counts))
    assert counts == dict.fromkeys(COUPLINGS, 2)


#: Reference FMU: options, variable, its value at the stop, of the project's own documents or exact
REFERENCE: dict[str, tuple[list[str], str, float, float]] = {
    # Euler steps of 0.1 s inside
    "Dahlquist": (["--step=0.5", "--stop=10"], "x", 0.9**100, 1e-12),
    # as six other importers have it
    "VanDerPol": (["--step=0.25", "--stop=1"], "x0", 1.509668337511498, 1e-14),
    "Resource": ([], "y", 97.0, 0.0),  # the letter in its file
    "Stair": (["--step=0.2", "--stop=5.1"], "counter", 6.0, 0.0),
    "BouncingBall": (["--step=0.01", "--stop=0.2"], "v", -9.81 * 0.2, 1e-9),
    "Feedthrough": (["--set=Float64_continuous_input=2.5", "--step=0.1"], "Float64_continuous_output", 2.5, 0.0),
}


@pytest.mark.slow
def test_reference_fmus(tmp_path: Path) -> None:
    paths = {(v, n): public(f"reference_fmus/{v}/{n}.fmu") for v in VERSIONS for n in REFERENCE}
    counts = Counter[str]()
    for (version, name), path in paths.items():
        unit = Path(shutil.copy(path, tmp_path))
        options, variable, expected, near = REFERENCE[name]
        for isolate in ([], ["--isolate"]):
            rows = table(tmp_path / "o.csv", str(unit), *options, *isolate)
            assert rows[variable][-1] == pytest.approx(expected, rel=near, abs=1e-15), (version, name)
            counts[version] += 1
    print(dict(counts))
    assert counts == dict.fromkeys(VERSIONS, 2 * len(REFERENCE))
