"""A machine at its extremes against its equations in phase coordinates, integrated by another method."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu import Collocated, Monolithic, NativeInstance, Options, build_model, run
from phfmu.components.electrical.machines.machine_data import machine_set
from phfmu.components.scenes.electrical.single_machine import lossless, spin_down, stall_start
from tests.components.phase_coordinates import ANGLES, PhaseMachine, integrated
from tests.wide import wide

HYDRO = machine_set("krause_hydro325", d=50.0)
Z, W = HYDRO.Vn_rms_ll**2 / HYDRO.Sn, HYDRO.omega
BOTH = ("dq-flux", "abc-flux")
#: order -> coarse step and the largest error at half of it, relative to the largest value
STEPS = {
    "spin_down": {1: (4e-4, 5e-3), 2: (4e-4, 2e-5), 3: (4e-4, 2e-8)},
    "stall_start": {1: (4e-4, 2e-3), 2: (4e-4, 1e-7), 3: (8e-4, 3e-10)},
    "lossless": {1: (5e-5, 4e-2), 2: (2e-4, 3e-4), 3: (2e-4, 6e-8)},
}


def simulated(scene, k: int, stop: float, step: float):
    model = build_model(scene.declaration(), Collocated(k))
    r = run(Monolithic(model, NativeInstance(model)), Options(stop=stop, step=step))
    assert r.ledger.summary().closed
    return r


def start_of(r) -> np.ndarray:
    """Fluxes of the windings, momentum and angle at the start of a run."""
    names = [n for n in r.names if n.startswith("gen.flux[")]
    return np.array([*(r.column(n)[0] for n in names), r.column("gen.p")[0], r.column("gen.theta")[0]])


def compared(r, currents: np.ndarray, momentum: np.ndarray) -> tuple[float, float]:
    """Errors of the phase currents and of the momentum, relative to their largest values."""
    own = np.array([r.column(f"gen.I[{k}]") for k in (1, 2, 3)]).T
    p = r.column("gen.p")
    return (
        float(np.abs(own - currents).max() / np.abs(currents).max()),
        float(np.abs(p - momentum).max() / np.abs(momentum).max()),
    )


def phase_run(machine: PhaseMachine, r, voltage, Vf: float) -> tuple[np.ndarray, np.ndarray]:
    """Currents and momentum of a machine alone behind `voltage(t)`."""
    x = integrated(lambda t, y, _: machine.rates(y, voltage(t), Vf, 0.0)[0], start_of(r), r.time)
    I = np.array([machine.rates(y, np.zeros(3), Vf, 0.0)[1][:3] for y in x])
    return I, x[:, -2]


def of_spin_down(coordinates: str, k: int, step: float) -> tuple[float, float]:
    scene = spin_down(coordinates=coordinates)
    r = simulated(scene, k, 0.2, step)
    Vf = next(p for p in scene.system.members["gen"].ports if p.name == "field").start
    machine = PhaseMachine(machine_set(HYDRO, J=HYDRO.J / 20.0), R=Z)
    return compared(r, *phase_run(machine, r, lambda _: np.zeros(3), np.ravel(Vf)[0]))


def of_stall_start(coordinates: str, k: int, step: float) -> tuple[float, float]:
    r = simulated(stall_start(coordinates=coordinates), k, 0.2, step)
    machine = PhaseMachine(machine_set("krause_hydro325", J=HYDRO.J / 100.0), 0.005 * Z, 0.1 * Z / W)
    v = HYDRO.Vn_rms_ll * np.sqrt(2.0 / 3.0)
    return compared(r, *phase_run(machine, r, lambda t: v * np.cos(W * t - ANGLES), 0.0))


def of_lossless(coordinates: str, k: int, step: float) -> tuple[float, float]:
    r = simulated(lossless(coordinates=coordinates), k, 0.2, step)
    machine = PhaseMachine(machine_set("krause_hydro325", Ra=0.0, R_rotor=[0.0] * 3, d=0.0))
    C = 0.3 / Z / W

    def rates(t, y, _):
        own, I = machine.rates(y[3:], y[:3] / C, 0.0, 0.0)
        return np.concatenate([-I[:3], own])

    x = integrated(rates, np.concatenate([np.zeros(3), start_of(r)]), r.time)
    I = np.array([machine.rates(y[3:], np.zeros(3), 0.0, 0.0)[1][:3] for y in x])
    return compared(r, I, x[:, -2])


WAYS = [(f, c, k) for f in (of_spin_down, of_stall_start, of_lossless) for c in BOTH for k in (1, 2, 3)]


@pytest.mark.parametrize(("errors", "coordinates", "k"), wide(WAYS, *[w for w in WAYS if w[1:] == ("dq-flux", 2)]))
def test_a_machine_at_its_extremes_has_the_order_of_the_scheme(errors, coordinates: str, k: int) -> None:
    step, most = STEPS[errors.__name__.removeprefix("of_")][k]
    coarse, fine = errors(coordinates, k, step), errors(coordinates, k, step / 2)
    assert max(fine) < most
    assert 2 * k - 0.3 < np.log2(coarse[0] / fine[0]) < 2 * k + 0.7


def charge(k: int, step: float) -> float:
    """How far p + (q_a (psi_c - psi_b) + ..)/sqrt(3), which no torque changes, moves beside p."""
    r = simulated(lossless(coordinates="abc-flux"), k, 0.3, step)
    n = r.ledger.summary().network
    assert not n.dissipated and not n.external
    for j in (4, 5, 6):
        psi = r.column(f"gen.flux[{j}]")
        assert np.abs(psi - psi[0]).max() < 1e-12 * np.abs(r.column("gen.flux[4]")).max()
    psi = np.array([r.column(f"gen.flux[{j}]") for j in (1, 2, 3)])
    q = np.array([r.column(f"bank.v[{j}]") for j in (1, 2, 3)]) * 0.3 / Z / W
    turned = ((psi[2] - psi[1]) * q[0] + (psi[0] - psi[2]) * q[1] + (psi[1] - psi[0]) * q[2]) / np.sqrt(3.0)
    p = r.column("gen.p")
    return float(np.ptp(p + turned) / np.ptp(p))


@pytest.mark.parametrize("k", [1, 2])
def test_a_lossless_machine_keeps_its_rotor_fluxes_and_the_charge_of_the_rotation(k: int) -> None:
    coarse, fine = charge(k, 2e-4), charge(k, 1e-4)
    assert fine < (1e-3, 1e-7)[k - 1]
    assert 2 * k - 0.2 < np.log2(coarse / fine) < 2 * k + 0.2


def test_standstill_and_braking_end_as_they_must() -> None:
    r = simulated(stall_start(), 2, 3.0, 4e-4)
    slip = 1.0 - r.column("gen.shaft.speed")[-1] / (HYDRO.omega / HYDRO.pole_pairs)
    assert r.column("gen.p")[0] == 0.0 and abs(slip) < 0.05
    r = simulated(spin_down(), 2, 2.0, 4e-4)
    assert r.column("gen.p")[-1] < 0.2 * r.column("gen.p")[0]
