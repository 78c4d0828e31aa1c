"""Redundant rows at starts and parameters that are set, and the forces that are told."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import NativeInstance, Options, PythonInstance, constraint_rank, project_start
from phfmu.cli import main
from phfmu.discretise.model import Model
from phfmu.fmu.export.export import export
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.runs.loop import run
from phfmu.studies.stress.mechanisms import G, bricard, hinge
from phfmu.words import folded
from tests.engine.mechanisms import crossing, hung, windows
from tests.engine.runs_at_rest import errors, model
from tests.engines import ENGINES
from tests.wide import wide

# -- starts and parameters that are set --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def typed() -> tuple[Model, np.ndarray]:
    """Bricard's linkage declared with coordinates that are off by 1e-3, where all rows are independent, and its start on them."""
    declaration = bricard()[0]
    q = declaration.states[0]
    off = 1e-3 * np.cos(np.arange(1.0, q.n + 1))
    m = model(declaration.with_starts(dict(zip(q.names(), q.start + off, strict=True))), 2)
    assert not m.step.hold.rests.any()
    return m, project_start(m).x


@pytest.mark.parametrize("steps", wide([40, 100, 400], 40))
def test_rows_rest_at_a_start_that_is_set(typed: tuple[Model, np.ndarray], steps: int) -> None:
    m, x = typed
    native, python = NativeInstance(m), PythonInstance(m)
    for instance in (native, python):
        instance.set_x(0.0, x)
        instance.initialise()
        (change,) = instance.rest_changes
        assert change.needed is None and change.time == 0.0
    assert python.rest_changes == native.rest_changes
    saved = native.get_state()
    near = [e.run(0.0, 0.01, 5, ("x",))["x"] for e in (native, python)]
    assert np.abs(near[0] - near[1]).max() <= 1e-13
    native.set_state(saved)
    g, w, energy = errors(native, 0.01, steps)
    assert g <= 1e-14 and w <= 1e-13 and energy <= 1e-13


def test_a_run_projects_a_start_onto_redundant_rows(typed: tuple[Model, np.ndarray]) -> None:
    m, _ = typed
    result = run(Monolithic(m, NativeInstance(m)), Options(stop=0.5, step=0.01, project=True))
    assert result.ledger.summary().closed
    assert re.fullmatch(r"at t = 0 s lambda\[\d+\] \(bar .*\) rests", result.notes[-1])


def test_units_let_rows_rest_at_starts_that_are_set(typed: tuple[Model, np.ndarray], tmp_path: Path) -> None:
    """Both versions; the unit's declaration has no redundant rows at its own start."""
    m, x = typed
    native = NativeInstance(m)
    native.set_x(0.0, x)
    native.initialise()
    native.run(0.0, 0.01, 20)
    names = [n for v in m.declaration.states for n in v.names()]
    start = dict(zip(names, x.tolist(), strict=True))
    for path in export(m, tmp_path, step=0.01):
        with FMUInstance(path, starts=start) as unit:
            for n in range(20):
                unit.do_step(0.01 * n, 0.01)
            assert np.abs([unit.values()[n] for n in names] - native.x).max() <= 1e-13


@pytest.mark.parametrize("engine", ENGINES)
def test_rows_are_needed_at_a_start_that_is_set(engine: Any) -> None:
    """Declared flat, set upright, and the other way round: forces and accelerations are those of the declaration there."""
    flat, upright = (model(windows(2, angle, pull=50.0), 2) for angle in (np.pi / 2, 0.3))
    for declared, there in ((flat, upright), (upright, flat)):
        instance, other = engine(declared), engine(there)
        instance.set_x(0.0, there.x0)
        instance.initialise()
        assert instance.signal("a_end") == pytest.approx(other.signal("a_end"), rel=1e-12, abs=1e-12)
        assert instance.signal("a") == pytest.approx(other.signal("a"), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_rows_rest_and_are_needed_as_parameters_are_set(engine: Any) -> None:
    crossed, along = (engine(model(crossing(slope), 2)) for slope in (1.0, 0.0))
    (i,) = (n for n, v in enumerate(crossed.model.declaration.parameters) if v.name == "slope")
    i += sum(v.n for v in crossed.model.declaration.parameters[:i]) - i
    for instance, slope in ((crossed, 0.0), (along, 1.0)):
        p = instance.parameters
        p[i] = slope
        instance.set_parameters(p)
        instance.initialise()
        force = [0.0, 0.0] if slope == 0.0 else [2.0 * G, -2.0 * G]  # -Dg^T lambda holds the weight
        assert instance.signal("a_end") == pytest.approx(force, abs=1e-13)
        instance.run(0.0, 0.01, 50)
        assert instance.x[:2] == pytest.approx([0.0, -0.5 * G * 0.5**2 if slope == 0.0 else 0.0], abs=1e-13)


# -- forces ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
def test_forces_are_of_least_norm_and_do_not_feel_scales(engine: Any) -> None:
    """A load on three equal bars, one of them declared a thousand times as large: a third each."""
    instance = engine(model(hung((1.0, 1.0, 1e3)), 2))
    instance.run(0.0, 0.01, 5)
    for block in ("a", "a_end"):
        lam = instance.signal(block) * [1.0, 1.0, 1e3]
        assert lam == pytest.approx(np.full(3, lam.sum() / 3), rel=1e-12)
    single = engine(model(hung((1.0,)), 2))
    single.run(0.0, 0.01, 5)
    assert lam.sum() == pytest.approx(single.signal("a_end")[0], rel=1e-12)


def test_the_report_names_rows_that_depend_on_each_other() -> None:
    found = constraint_rank(bricard()[0])
    assert (found.rows, found.rank) == (39, 38)
    ((names, many),) = found.groups
    assert many == 1 and found.redundant[0].name in names and set(found.redundant[0].of) < set(names)
    assert f"1 of these is too many: {', '.join(names)}" in found.report()
    assert set(found.redundant[0].support) == set(names)
    assert len(found.unique) == 39 - len(names) and not set(found.unique) & set(names)


def test_unique_forces_are_those_that_no_null_vector_touches(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A hinge on two pins with a corner: the pins and the bar between them share a force along it, the door's bars none."""
    found = constraint_rank(hinge())
    bars, pins = ("lambda[1]", "lambda[2]"), found.groups[0][0]
    assert set(bars) <= set(found.unique) and "lambda[3]" in pins
    # the bar lies in the plane x = 0: forces along x at the pins are unique as well
    assert set(found.unique) == {*bars, "lambda[4]", "lambda[7]"}
    script = tmp_path / "scene.py"
    script.write_text("from phfmu.studies.stress.mechanisms import hinge\n")
    assert main(["info", f"{script}:hinge"]) == 0
    text = capsys.readouterr().out
    assert "constraints: 9 rows of rank 8 at the start" in text
    assert "unique forces: lambda[1..2], lambda[4], lambda[7]" in text
    assert f"it is {found.redundant[0].label}" in text and found.redundant[0].label


def test_names_in_a_row_are_folded() -> None:
    assert folded(["a", "b[1]", "b[2]", "b[3]", "b[5]", "c[6]", "c", "d"]) == "a, b[1..3], b[5], c[6], c, d"
    assert folded([]) == ""
