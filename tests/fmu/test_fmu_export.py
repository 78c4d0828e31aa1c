"""Exported units: valid, equal to the engines, the same bytes twice."""

from __future__ import annotations

import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from phfmu import (
    PHDAE,
    energy,
    parameter,
    state,
)
from phfmu.discretise.model import build_model
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.reference.python import PythonInstance
from phfmu.fmu.export import sources
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.export import export
from phfmu.fmu.export.variables import FMUError, variables
from phfmu.fmu.importer.reader import FMUInstance
from tests.fmu.exported import MODELS, QUICK, build
from tests.wide import wide

SCHEMA = Path(str(fmpy.__file__)).parent / "schema" / "fmi3"


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("name", wide(MODELS, *QUICK))
def test_units_are_valid(exported, name: str, version: str) -> None:
    path = exported(name)[3][version]
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        parts = {"terminalsAndIcons/terminalsAndIcons.xml": "fmi3TerminalsAndIcons.xsd",
                 "sources/buildDescription.xml": "fmi3BuildDescription.xsd"}  # fmt: skip
        for part, schema in parts.items():
            if part in archive.namelist():
                etree.XMLSchema(file=str(SCHEMA / schema)).assertValid(etree.fromstring(archive.read(part)))
        listed = etree.fromstring(archive.read("sources/buildDescription.xml")).findall(".//SourceFile")
        assert "interpret.c" not in {f.get("name") for f in listed}
        assert all(f"sources/{f.get('name')}" in archive.namelist() for f in listed)
        assert not [n for n in archive.namelist() if n.endswith(("fmi2Functions.h", "fmi3Functions.h"))]
        terminals = "terminalsAndIcons/terminalsAndIcons.xml" in archive.namelist()
        assert terminals == (exported(name)[1].step.nu > 0), "a unit without ports has no file about them"


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("name", wide(MODELS, *QUICK))
def test_unit_equals_the_engines(exported, name: str, version: str) -> None:
    declaration, model, h, paths = exported(name)
    n, nu = 100, model.step.nu
    inputs = [name for p in declaration.ports if p.external for name in p.input_names()]
    u = np.sin(0.2 * np.arange(n + 1))[:, None] * (1.0 + np.arange(nu))
    signals = np.zeros(n + 1, [("time", float), *((name, float) for name in inputs)])
    signals["time"] = h * np.arange(n + 1)
    for j, column in enumerate(inputs):
        signals[column] = u[:, j]
    states = [name for v in declaration.states for name in v.names()]
    means = [name for p in declaration.ports if p.external for name in p.output_names("_step")]
    names = states + means + ["energy.stored", "energy.dissipated", "energy.residual"]

    python, native = PythonInstance(model), NativeInstance(model)
    rows = []
    # FMPy interpolates inputs, so it is given a table of steps: both engines hold u_k over step k
    with FMUInstance(paths[version]) as unit:
        for k in range(n):
            for instance in (python, native, unit):
                instance.set_input(u[k])
                instance.do_step(k * h, h)
            rows.append(unit.get(names))
            np.testing.assert_array_equal(unit.output(), native.output())
            for key, value in native.ledger().items():
                if key not in ("pairs", "numerical"):  # units do not tell these
                    np.testing.assert_allclose(unit.ledger()[key], value.sum(), rtol=1e-14, atol=1e-300)
        scale = np.abs(rows).max(axis=0) + 1e-9
        signals_now = python.signals()
        expected = np.concatenate([signals_now["x"][: len(states)], python.output(),
                                   [signals_now["H"].sum(), signals_now["dissipated"].sum()]])  # fmt: skip
        np.testing.assert_array_less(np.abs(rows[-1][:-1] - expected) / scale[:-1], 1e-11)
        moved = np.abs(unit.get(["energy.stored", "energy.supplied", "energy.dissipated"])).sum()
        assert abs(rows[-1][-1]) <= 1e-14 * n * (moved + 1.0), "the ledger of the unit closes"


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_simulate_fmu_runs_it_with_other_start_values(exported, version: str) -> None:
    _, model, h, paths = exported("mass")
    start = {"q": 0.3, "k": 250.0}
    result = fmpy.simulate_fmu(
        str(paths[version]),
        stop_time=100 * h,
        output_interval=h,
        start_values=start,
        output=["q", "v"],
    )
    native = NativeInstance(model)
    native.set_parameters([2.0, 250.0, 0.5])
    native.set_x(0.0, [0.3, 0.0])
    native.initialise()
    for k in range(100):
        native.do_step(k * h, h)
    assert len(result) == 101
    np.testing.assert_allclose([result["q"][-1], result["v"][-1]], native.x, rtol=1e-11)


def test_same_model_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def written(folder: str) -> list[bytes]:
        declaration, model, step = build("pendulum")
        return [p.read_bytes() for p in export(model, tmp_path / folder, step=step, stop=1.0)]

    first = written("a")
    assert written("b") == first
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    dated = written("c")
    assert written("d") == dated != first
    text = zipfile.ZipFile(tmp_path / "c" / "pendulum_fmi3.fmu").read("modelDescription.xml")
    assert b'generationDateAndTime="2023-11-14T22:13:20Z"' in text


def test_token_belongs_to_the_content() -> None:
    declaration, model, step = build("mass")
    token = [
        sources.token(unit, sources.generated(unit))
        for unit in (
            ExportedUnit(model, step),
            ExportedUnit(model, step),
            ExportedUnit(model, 2 * step),
            ExportedUnit(build_model(declaration.with_starts({"k": 99.0})), step),
        )
    ]
    assert token[0] == token[1]
    assert len(set(token)) == 3
    assert all(len(t) == 38 for t in token)


def test_names_are_those_of_the_contract(exported) -> None:
    declaration, model, _, _ = exported("pendulum")
    v = {v.name: v for v in variables(model)}
    names = "hand.f[1] hand.v[2] hand.v_step[2] hand.energy lambda[1] lambda_end[1] p[2] energy.residual"
    assert {*names.split(), "constraint.position.lambda[1]", "constraint.velocity.lambda[1]"} <= set(v)
    assert (v["q[1]"].causality, v["q[1]"].initial, v["q[1]"].start) == ("local", "exact", 0.6)
    assert (v["m"].causality, v["m"].variability) == ("parameter", "fixed")
    composed, model, _, _ = exported("chain")
    names = {v.name: v for v in variables(model)}
    assert names["near.energy.stored"].causality == "local"
    assert names["energy.stored"].count == len(model.members)
    assert names["far.a.i_step[3]"].causality == "local", "joined inside"
    assert names["far.b.i_step[3]"].causality == "output"


def test_illegal_and_repeated_names_are_refused_together(tmp_path: Path) -> None:
    q = state("q 1", unit="m", start=1.0)
    declaration = PHDAE("bad", states=(q,), energies=(energy(0.5 * q.sx**2),), parameters=(parameter("time", 1.0),))
    with pytest.raises(FMUError, match="'q 1' is no structured name.*two variables are called 'time'"):
        export(build_model(declaration), tmp_path, step=0.1)
    declaration, model, _ = build("mass")
    with pytest.raises(FMUError, match="step = 0"):
        export(model, tmp_path, step=0.0)
    with pytest.raises(FMUError, match="known: 2.0, 3.0"):
        export(model, tmp_path, versions=("1.0",), step=0.1)
    with pytest.raises(FMUError, match="unknown platform amiga"):
        export(model, tmp_path, step=0.1, platforms=["amiga"])
    assert not list(tmp_path.iterdir())


def test_without_a_step_time_terminals_or_members_nothing_is_written_about_them(exported, tmp_path: Path) -> None:
    declaration, model, _, paths = exported("four_particle")
    (path,) = export(model, tmp_path, ("3.0",), step=0.01)
    text = zipfile.ZipFile(path).read("modelDescription.xml")
    assert b"stopTime" not in text and b"_step[" not in text and b"member" not in text
    names = zipfile.ZipFile(path).namelist()
    assert not [n for n in names if n.startswith(("terminals", "resources")) or "fmi2" in n]
    assert all("fmi3" not in n for n in zipfile.ZipFile(paths["2.0"]).namelist())
