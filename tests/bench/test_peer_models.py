"""Models of other programs are the same mechanisms: at small steps they end where the independent reference ends."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest

from phfmu.studies.bench.mechanisms import described, exudyn_models, ida, mujoco_models, opensim_models
from phfmu.studies.bench.mechanisms.case import MechanismCase
from phfmu.studies.bench.mechanisms.cases import CASES, IFTOMM
from phfmu.studies.bench.mechanisms.lagrange import lagrange_of
from phfmu.studies.bench.power import circuit, dpsim
from phfmu.studies.bench.power.kundur import Kundur
from phfmu.studies.bench.precision.candidate import NotAvailable


@cache
def case(name: str) -> MechanismCase:
    """A case with its reference solved."""
    made = (CASES | IFTOMM)[name]()
    made.solve_reference()
    return made


def error(made: MechanismCase, solve: object) -> float:
    assert callable(solve)
    return made.judge(solve([made.stop]).x).errors[0]


@pytest.mark.parametrize("name", ["chain of 4", "slider-crank", "bricard", "andrews", "car axis", "ur5"])
def test_the_numbers_are_the_declaration(name: str, compiler: None) -> None:
    """Order 6 at its shortest step against Lagrange's equations in other coordinates, which the step before misses by more."""
    made = case(name)
    sixth = [c for c in made.own() if c.method == "phfmu, order 6"][-2:]
    coarse, fine = (error(made, c.prepare()) for c in sixth)
    assert made.uncertainty < 1e-11
    assert fine < 2e-10 and fine < coarse / 2


def test_andrews_in_joint_angles_is_published() -> None:
    """The crank's centre at 0.03 s from the published angle, of which eight decimals are agreed on."""
    beta = 15.81077119629904
    place = np.array([0.00092 * np.cos(beta), 0.00092 * np.sin(beta)])
    assert case("andrews").reference[-1][:2] == pytest.approx(place, abs=1e-8 * 0.00092)


@pytest.mark.parametrize(
    ("name", "most"), [("chain of 4", 1e-9), ("ur5", 1e-8), ("slider-crank", 1e-5), ("bricard", 1e-7)]
)
def test_mujoco_ends_there(name: str, most: float) -> None:
    """Trees to the order of its method, loops to that of its soft constraints."""
    pytest.importorskip("mujoco")
    made = case(name)
    h = 0.001
    coarse, fine = (error(made, mujoco_models.MuJoCo(made, k * h)) for k in (2, 1))
    assert fine < most and fine < coarse / 1.5


@pytest.mark.parametrize("name", ["chain of 4", "slider-crank", "bricard", "andrews", "ur5"])
def test_exudyn_ends_there(name: str) -> None:
    """Constrained bodies of order 2; trees of order 6."""
    pytest.importorskip("exudyn")
    made = case(name)
    steps = made.steps.exudyn
    for method in ("exudyn generalized-alpha", "exudyn trapezoidal index 2"):
        found = [error(made, c.prepare()) for c in exudyn_models.candidates(made) if c.method == method]
        assert np.log(found[0] / found[1]) / np.log(steps[0] / steps[1]) == pytest.approx(2.0, abs=0.4), method
    tree = [error(made, c.prepare()) for c in exudyn_models.candidates(made) if c.method == "exudyn tree RK67"]
    assert bool(tree) == (name in ("chain of 4", "ur5")) and all(e < 1e-8 for e in tree[-1:])


@pytest.mark.parametrize("name", ["andrews", "car axis"])
def test_ida_ends_there(name: str, compiler: None) -> None:
    pytest.importorskip("sksundae")
    made = case(name)
    found = [error(made, c.prepare()) for c in ida.candidates(made)]
    assert found[-1] < 1e-8 and found[-1] < found[0] / 1e3


@pytest.mark.parametrize("name", ["A01 pendulum", "A03 andrews", "A04 bricard"])
def test_opensim_ends_there(name: str) -> None:
    if not os.environ.get(opensim_models.VARIABLE):
        pytest.skip(f"{opensim_models.VARIABLE} names no interpreter with OpenSim")
    made = case(name)
    found = [error(made, c.prepare()) for c in opensim_models.candidates(made)]
    assert found[-1] < 1e-6 and found[-1] < found[0] / 10


def test_absent_peers_say_how_to_get_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(opensim_models.VARIABLE, raising=False)
    made = IFTOMM["A01 pendulum"]()
    (absent,) = opensim_models.candidates(made)
    with pytest.raises(NotAvailable, match="environment of its own"):
        absent.prepare()
    monkeypatch.setenv(opensim_models.VARIABLE, "/nowhere/python")
    with pytest.raises(NotAvailable, match="/nowhere/python"):
        next(opensim_models.candidates(made)).prepare()


def test_a_slider_that_closes_a_loop_is_refused() -> None:
    crank = described.slider_crank()
    order = [crank.links[i] for i in (0, 1, 3, 2)]
    with pytest.raises(ValueError, match="let the slider be in the tree"):
        lagrange_of(replace(crank, links=tuple(order)))


def test_dpsim_ends_where_kundurs_equations_end() -> None:
    """Currents up to the fault and 10 ms of it; error of order 1 in the step."""
    if find_spec("dpsimpy") is None:
        pytest.skip(dpsim.obstacle())
    net = dpsim.smib(dpsim.FULL, circuit.STOP) | {"stop": 0.11}
    times = np.arange(1, 111) * 1e-3
    exact = Kundur().currents(times, circuit.STOP)
    peak = np.abs(exact).max()
    coarse, fine = (
        np.abs(np.array(dpsim.run(net, h, log=True)["rows"])[1:, :3] - exact).max() / peak for h in (2e-5, 1e-5)
    )
    assert fine < 1e-3 and coarse / fine == pytest.approx(2.0, abs=0.3)
