"""Scenes against independent references: closed forms, matrix exponentials, and DOP853 in abc flux coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_tools import read

from phfmu import Collocated, NativeInstance, Options, Scene, build_model, run
from phfmu.components.scenes.drive import drive
from phfmu.components.scenes.electrical.smib import smib, smib_hydro
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.members.engine_member import EngineMember
from phfmu.runs.result import Result
from tests.wide import wide

RATED = 18881.48  # A, peak, of kundur555_1q


def monolithic(scene: Scene, h: float, stop: float, k: int = 1) -> Result:
    model = build_model(scene.declaration(), Collocated(k))
    return run(Monolithic(model, NativeInstance(model)), Options(stop=stop, step=h, events=scene.events))


def coupled(scene: Scene, h: float, stop: float) -> Result:
    members = []
    for name, declaration in scene.system.members.items():  # type: ignore[union-attr]
        model = build_model(replace(declaration, name=name))
        members.append(EngineMember(name, model, NativeInstance(model)))
    return run(Coupled(scene.system, members), Options(stop=stop, step=h, events=scene.events))  # type: ignore[arg-type]


def closed(result: Result, rtol: float) -> bool:
    """True if every component's step residual is below rtol of the energy in play."""
    return max(c.worst_relative for c in result.ledger.summary().components) <= rtol


def slope(errors: list[float]) -> np.ndarray:
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


def at(result: Result, times: np.ndarray, name: str) -> np.ndarray:
    i = [int(np.argmin(np.abs(result.time - t))) for t in times]
    assert np.allclose(result.time[i], times, rtol=0, atol=1e-12)
    return result.column(name)[i]


# -- oscillator: q1 = (cos 2 pi t + cos 6 pi t)/2 ---------------------------------------------------------------------


@pytest.mark.parametrize("how", [monolithic, coupled])
def test_oscillator_errors(how) -> None:
    """The midpoint rule's error of q1, independent of how the cut is coupled."""
    expected = {0.04: 3.591e-1, 0.02: 1.022e-1, 0.01: 2.598e-2, 0.005: 6.514e-3}
    for h, value in expected.items():
        r = how(oscillator(), h, 1.0)
        exact = (np.cos(2 * np.pi * r.time) + np.cos(6 * np.pi * r.time)) / 2
        assert np.max(np.abs(r.column("mass1.q") - exact)) == pytest.approx(value, rel=0.01)
        H = _stored(r)
        assert np.max(np.abs(H - H[0])) / H[0] <= 1e-13
        assert closed(r, 1e-13)


def _stored(r: Result) -> np.ndarray:
    members = [n for n in r.names if n.endswith(".energy.stored")]
    return np.sum([r.column(n) for n in members], axis=0)


def test_oscillator_coupled_equals_composed() -> None:
    a, b = monolithic(oscillator(), 0.01, 1.0), coupled(oscillator(), 0.01, 1.0)
    for name in ("mass1.q", "mass2.q", "spring12.e", "mass1.v"):
        assert np.max(np.abs(a.column(name) - b.column(name))) <= 1e-10 * np.max(np.abs(a.column(name)))


# -- drive: matrix exponential ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("k", "order"), [(1, 2), (2, 4)])
def test_drive_against_matrix_exponential(k: int, order: int) -> None:
    ref = read("drive")
    names = {"i": "motor.i", "w1": "motor.w", "w2": "load.w"}
    errors = []
    for h in (1e-4, 5e-5):
        r = monolithic(drive(), h, 0.1, k)
        errors.append(
            max(np.max(np.abs(at(r, ref["time"], n) - ref[c])) / np.max(np.abs(ref[c])) for c, n in names.items())
        )
        assert closed(r, 1e-12)
    assert slope(errors)[0] == pytest.approx(order, abs=0.15)


# -- machines ---------------------------------------------------------------------------------------------------------


def stator_error(r: Result, ref: dict, prefix: str, column: str, until: float) -> float:
    rows = ref["time"] <= until + 1e-12
    t = ref["time"][rows]
    return max(np.max(np.abs(at(r, t, f"{prefix}.I[{j}]") - ref[f"{column}[{j}]"][rows])) for j in (1, 2, 3))


@pytest.mark.parametrize("scene", wide([smib, smib_hydro], smib))
def test_smib_order_and_steady_start(scene) -> None:
    ref = read(scene.__name__)
    late, early = [], []
    for h in (2e-4, 1e-4):
        r = monolithic(scene(), h, 1.0)
        late.append(stator_error(r, ref, "gen", "I", 1.0))
        early.append(stator_error(r, ref, "gen", "I", 0.5))
        assert closed(r, 1e-11)
    assert early[1] <= 1e-3 * RATED
    np.testing.assert_allclose(slope(late), 2.0, atol=0.05)
    np.testing.assert_allclose(slope(early), 2.0, atol=0.05)


@pytest.mark.parametrize("coordinates", wide(["abc-flux", "current"]))
def test_smib_in_other_coordinates(coordinates) -> None:
    ref = read("smib")
    errors = []
    for h in (1e-4, 5e-5):
        r = monolithic(smib(coordinates=coordinates), h, 0.6)
        errors.append(stator_error(r, ref, "gen", "I", 0.6))
        assert closed(r, 1e-11)
    assert slope(errors)[0] == pytest.approx(2.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("how", wide([monolithic, coupled], coupled))
def test_two_machine_through_fault_and_clearing(how) -> None:
    """Order 2 in currents and angles through both events (moved to 0.02 s and 0.06 s)."""
    ref = read("two_machine_early")
    steps = (1e-4, 5e-5) if how is monolithic else (1e-4,)
    errors, angles = [], []
    for h in steps:
        scene = two_machine(t_fault=0.02, t_clear=0.06, stop=0.1)
        r = how(scene, h, 0.1)
        errors.append(
            max(stator_error(r, ref, f"m{m}", f"I{m}", 0.1) / np.max(np.abs(ref[f"I{m}[1]"])) for m in (1, 2))
        )
        angles.append(np.max(np.abs(at(r, ref["time"], "m1.theta") - ref["theta1"])))
        assert closed(r, 1e-11)
    assert errors[0] <= 3e-4 and angles[0] <= 1e-5
    if how is monolithic:
        assert slope(errors)[0] == pytest.approx(2.0, abs=0.05)
        assert slope(angles)[0] == pytest.approx(2.0, abs=0.05)


def test_two_machine_coupled_equals_composed() -> None:
    """Members exchange step means and the impulses of their bare node, as the composed model does."""
    scene = two_machine(t_fault=0.002, t_clear=0.004, stop=0.006)
    a, b = monolithic(scene, 1e-4, 0.006), coupled(scene, 1e-4, 0.006)
    for name in ("m1.I[1]", "m2.I[4]", "m1.theta", "line.i[2]", "load.v[1]"):
        assert np.max(np.abs(a.column(name) - b.column(name))) <= 1e-9 * np.max(np.abs(a.column(name)))


@pytest.mark.slow
def test_two_machine_scene_as_declared() -> None:
    """Fault at 0.1 s and clearing at 0.2 s, to 1 s."""
    ref = read("two_machine")
    errors = []
    for h in (1e-4, 5e-5):
        r = monolithic(two_machine(), h, 1.0)
        errors.append(stator_error(r, ref, "m1", "I1", 1.0))
        assert closed(r, 1e-11)
    assert slope(errors)[0] == pytest.approx(2.0, abs=0.1)
