"""Lines, loads, sources and switches against exact solutions."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from phfmu import time
from phfmu.components.electrical import (
    current_source,
    fault_resistor,
    infinite_bus,
    machine_set,
    rl_line,
    rlc_load,
    voltage_source,
)
from tests.components.orders import orders, steps

OMEGA = 120.0 * np.pi


# -- lines, loads, sources, switches ----------------------------------------------------------------------


class TwoTones:
    """u_j(t) = offset + a_j sin(w1 t + p_j) + b_j cos(w2 t) and its exact response of x' = A x + B u."""

    def __init__(self, n, size, seed=3):
        rng = np.random.default_rng(seed)
        self.w = np.array([OMEGA, 1.9 * OMEGA])
        self.C = size * rng.uniform(-1, 1, (n, 5))

    def basis(self, t):
        a = self.w * t
        return np.array([1.0, *np.sin(a), *np.cos(a)])

    def __call__(self, t):
        return self.C @ self.basis(t)

    def response(self, A, B, x0, t):
        """x(t), by the exponential of the system together with its oscillators."""
        generator = np.zeros((5, 5))
        generator[1:3, 3:5], generator[3:5, 1:3] = np.diag(self.w), -np.diag(self.w)
        n = len(x0)
        M = np.zeros((n + 5, n + 5))
        M[:n, :n], M[:n, n:], M[n:, n:] = A, B @ self.C, generator
        return (expm(M * t) @ np.array([*x0, *self.basis(0.0)]))[:n]


def check_linear(model, A, B, x0, size, outputs, end=0.02):
    """Orders 2 and 4 of the state against the exponential; outputs(x, u) at the end; closed ledger."""
    u = TwoTones(B.shape[1], size)
    exact = u.response(A, B, x0, end)
    scale = np.abs(exact).max()
    for k, counts in ((1, (80, 160)), (2, (20, 40))):
        errors = []
        for n in counts:
            instance, worst = steps(model, k, end / n, n, u)
            assert worst < 1e-13
            errors.append(float(np.linalg.norm(instance.x - exact)) / scale)
            y = instance.signals()["y_end"]
            assert y == pytest.approx(outputs(instance.x, u(end)), rel=1e-10, abs=1e-10 * np.abs(y).max())
        assert errors[-1] < 2e-3
        assert 2 * k - 0.2 < orders(errors)[0] < 2 * k + 0.4, errors


def test_rl_line():
    R, L, i0 = 0.3, 2e-3, [30.0, -10.0, 5.0]
    A, B = -R / L * np.eye(3), np.hstack([np.eye(3), -np.eye(3)])
    model = rl_line(R, L, i=i0, v=100.0)
    check_linear(model, A, B, L * np.array(i0), 100.0, lambda x, u: [*(x / L), *(-x / L)])


def test_rlc_load_with_capacitor():
    R, L, C, v0, i0 = 5.0, 0.02, 4e-4, [100.0, 20.0, -80.0], [3.0, -4.0, 6.0]
    E = np.eye(3)
    A = np.block([[0 * E, E / C], [-E / L, -E / (R * C)]])
    model = rlc_load(R, L, C, v=v0, i=i0, nominal=100.0)
    x0 = np.array([*(L * np.array(i0)), *(C * np.array(v0))])
    check_linear(model, A, np.vstack([0 * E, E]), x0, 20.0, lambda x, u: x[3:] / C)


def test_rl_load_takes_the_voltage_and_gives_both_currents():
    R, L, i0 = 5.0, 0.02, [3.0, -4.0, 6.0]
    model = rlc_load(R, L, i=i0, nominal=100.0)
    x0 = L * np.array(i0)
    check_linear(model, np.zeros((3, 3)), np.eye(3), x0, 100.0, lambda x, u: u / R + x / L)


def test_single_element_loads_have_only_what_they_need():
    assert not rlc_load(L=1.0).algebraics and not rlc_load(C=1.0).dissipation and not rlc_load(R=1.0).states
    assert [p.name for p in rlc_load(C=1.0).parameters] == ["C"]
    start, A, B, size = np.array([1.0, 2.0, 3.0]), np.zeros((3, 3)), np.eye(3), 0.01
    for load in (rlc_load(C=size, v=start.tolist()), rlc_load(L=size, i=start.tolist())):
        check_linear(load, A, B, size * start, 20.0, lambda x, u: x / size)


@pytest.mark.parametrize("build, words", [
    (lambda: rlc_load(), "at least one"), (lambda: rlc_load(R=0.0), "R = 0.0 must be positive"),
    (lambda: rlc_load(C=-1.0), "C = -1.0"), (lambda: rl_line(1.0, 0.0), "L = 0.0"),
    (lambda: rl_line(-1.0, 1.0), "R = -1.0"), (lambda: fault_resistor(-1.0), "G = -1.0"),
])  # fmt: skip
def test_impossible_parameters_are_refused(build, words):
    with pytest.raises(ValueError, match=words):
        build()


@pytest.mark.parametrize("G", [0.0, 20.0, (0.0, 20.0, 1e5)])
def test_fault_resistor(G):
    """i = G v at every node; its heat is the integral of G v^2."""
    values = np.broadcast_to(np.asarray(G, float), 3)
    model = fault_resistor(nominal=100.0).with_starts({f"G[{j + 1}]": g for j, g in enumerate(values)})
    u, h, n = TwoTones(3, 100.0), 1e-4, 50
    instance, worst = steps(model, 2, h, n, u)
    assert worst < 1e-13
    assert instance.signals()["y_end"] == pytest.approx(values * u(h * n), rel=1e-12, abs=1e-12)
    t, w = np.polynomial.legendre.leggauss(40)
    heat = sum(wi * h * n / 2 * float(values @ u(h * n * (ti + 1) / 2) ** 2) for ti, wi in zip(t, w, strict=True))
    assert float(instance.signals()["dissipated"][0]) == pytest.approx(heat, rel=1e-6, abs=1e-12)


def test_infinite_bus_holds_its_voltage_and_passes_the_power_to_its_source():
    amplitude, frequency, phase = 100.0, 50.0, 0.3
    model = infinite_bus(amplitude, frequency, phase, i=30.0)
    u, h, n = TwoTones(3, 30.0), 1e-4, 60
    instance, worst = steps(model, 2, h, n, u)
    end, signals = h * n, instance.signals()

    def voltage(t):
        return amplitude * np.cos(2 * np.pi * frequency * t + phase - np.array([0, 2, -2]) * np.pi / 3)

    assert worst < 1e-13
    assert signals["y_end"][:3] == pytest.approx(voltage(end), rel=1e-12)
    t, w = np.polynomial.legendre.leggauss(40)
    at = end * (t + 1) / 2
    work = np.array([sum(w[j] * end / 2 * voltage(at[j])[x] * u(at[j])[x] for j in range(40)) for x in range(3)])
    assert signals["energy"][:3] == pytest.approx(work, rel=1e-6)
    assert signals["energy"][:3] == pytest.approx(-signals["energy"][3:], rel=1e-12)
    assert model.port("source").external is False and model.port("terminal").given == "flow"


def test_scalar_sources():
    u, h, n = TwoTones(1, 10.0), 1e-3, 20
    wave = 3.0 * ca.sin(40.0 * time) + 1.0
    for model, sign in ((voltage_source(wave), 1.0), (current_source(wave), -1.0)):
        instance, worst = steps(model, 1, h, n, u)
        signals = instance.signals()
        assert worst < 1e-13
        assert signals["y_end"][0] == pytest.approx(sign * (3.0 * np.sin(40.0 * h * n) + 1.0), rel=1e-12)
        assert signals["energy"][0] == pytest.approx(-signals["energy"][1], rel=1e-12)
        assert abs(signals["energy"][0]) > 0.01


def test_entries_of_a_machine_that_would_be_ignored_are_refused() -> None:
    """A misspelt entry of a mapping left its default in place without a word."""
    from dataclasses import asdict

    whole = asdict(machine_set("kundur555_1q"))
    assert machine_set(whole) == machine_set("kundur555_1q")
    for changed, said in (
        ({"pole_pair": 2}, "unknown entry 'pole_pair'; did you mean pole_pairs"),
        ({"H": 7.0}, "H = 7 s, but J gives 3.525 s"),
        ({"Laa0": 1e-3}, "Laa0 without Laa2, Lab0"),
        ({"Laa0": 2e-3, "Laa2": 0.0, "Lab0": 5e-4}, "Laa0, Laa2, Lab0 give 0.0025 H; leave one of them out"),
    ):
        with pytest.raises(ValueError, match=said):
            machine_set(whole | changed)
    with pytest.raises(ValueError, match="no machine set 'kundur555'; did you mean kundur555_1q?"):
        machine_set("kundur555")
    moved = machine_set("kundur555_1q", Laa0=3.5e-3, Laa2=0.0, Lab0=1.5e-3)  # instead of the set's own
    assert moved.Ld == pytest.approx(5e-3)


@pytest.mark.parametrize(("frequency", "hertz"), [(377.0, 60), (2 * np.pi * 50, 50)])
def test_a_frequency_that_looks_like_an_angular_one_is_told(frequency, hertz):
    with pytest.warns(
        UserWarning, match=f"frequency = .* is 2 pi {hertz}, most likely rad/s; .* give frequency={hertz}"
    ):
        infinite_bus(100.0, frequency)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("frequency", [0.0, 16.7, 50.0, 60.0, 400.0])
def test_frequencies_of_grids_pass_without_a_word(frequency):
    assert infinite_bus(100.0, frequency).parameters[1].start == (2 * np.pi * frequency,)
