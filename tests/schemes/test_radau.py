"""Radau IIA: order, the loss it books, and restart steps after events."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    Collocated,
    DeclarationError,
    Event,
    Monolithic,
    Options,
    PythonInstance,
    Radau,
    algebraic,
    block,
    build_model,
    damping,
    energy,
    parameter,
    run,
    skew,
    state,
)
from phfmu.components.library import build
from phfmu.gradients.quadrature import nodes, radau_nodes
from phfmu.outcome.steps import balance
from phfmu.runs.march.restart import Restart
from phfmu.schemes.named import named_scheme
from tests.engines import ENGINES
from tests.wide import wide


def stability(nd, z):
    """R(z) = 1 + z b^T (I - z A)^-1 1 of a Runge-Kutta method."""
    return 1 + z * nd.b @ np.linalg.solve(np.eye(nd.k) - z * nd.a, np.ones(nd.k))


@pytest.mark.parametrize("k", [1, 2, 3])
def test_radau_nodes_are_exact_up_to_degree_2k_minus_2_and_end_with_the_step(k):
    nd = radau_nodes(k)
    assert nd.c[-1] == 1.0
    assert (nd.b > 0).all()
    assert np.array_equal(nd.a[-1], nd.b)
    for degree in range(2 * k - 1):
        assert nd.b @ nd.c**degree == pytest.approx(1 / (degree + 1), rel=1e-14)
    assert abs(stability(nd, -1e9)) < 1e-8
    assert abs(stability(nodes(k), -1e9)) == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_loss_of_quadratic_energies_has_a_semidefinite_matrix(k):
    """Algebraic stability: BA + A^T B - b b^T >= 0, and 0 for Gauss nodes."""
    for nd, zero in ((radau_nodes(k), False), (nodes(k), True)):
        m = nd.b[:, None] * nd.a
        m = m + m.T - np.outer(nd.b, nd.b)
        size = np.linalg.eigvalsh(m)
        assert size.min() > -1e-15
        assert (size.max() < 1e-15) == zero


BETA, G = 0.5, 0.4


def circuit() -> PHDAE:
    """q' = phi - i, phi' = -v - phi/2, 0 = v - (G + i^2/2) i with v = q + beta q^3: index 1, H not quadratic."""
    q, phi = state("q", start=0.9), state("phi", start=-0.4)
    i = algebraic("i", start=0.5)
    return PHDAE(
        "circuit",
        states=(q, phi),
        algebraics=(i,),
        energies=(energy(q**2 / 2 + BETA * q**4 / 4), energy(phi**2 / 2)),
        structure=(skew(q, phi, 1.0), skew(q, i, -1.0)),
        dissipation=(damping(phi, 0.5), block([i], G + i**2 / 2)),
    )


def circuit_end(t):
    def rate(_, x):
        q, phi = x
        v = q + BETA * q**3
        a = np.cbrt(v + np.sqrt(v**2 + (2 * G / 3) ** 3))
        return [phi - (a - 2 * G / 3 / a), -v - phi / 2]

    return solve_ivp(rate, (0.0, t), (0.9, -0.4), method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]


@pytest.mark.parametrize("k", wide([1, 2, 3], 2, 3))
def test_index_one_circuit_has_order_2k_minus_1_and_closes_with_its_loss(k):
    instance, exact, errors = PythonInstance(build_model(circuit(), Radau(k))), circuit_end(2.0), []
    steps = {1: (200, 400, 800), 2: (20, 40, 80), 3: (8, 16, 32)}[k]
    for n in steps:
        instance.reset()
        rows = instance.run(0.0, 2.0 / n, n, ("stored", "dissipated", "numerical", "supplied"))
        assert np.max(np.abs(balance(**rows))) <= 1e-15
        assert np.max(np.abs(instance.signal("residual"))) <= 1e-14  # the sum since the start; the loss is in it
        errors.append(np.max(np.abs(instance.x - exact)))
    assert np.log2(errors[-2] / errors[-1]) == pytest.approx(2 * k - 1, abs=0.15)
    # the loss is of the order of the local error's energy: h^2k in total
    assert 0 < rows["numerical"].sum() < 1e-1 ** (2 * k - 1)


def decay(slow: float = 0.0) -> PHDAE:
    """A capacitor of 1 uF with a switched conductance: with G = 1/14 S its RC is 14 us; 4 kV on it."""
    q, g = state("q", unit="C", start=4e-3, nominal=4e-3), parameter("G", slow, unit="S")
    return PHDAE("decay", states=(q,), parameters=(g,), energies=(energy(q**2 / 2e-6),), dissipation=(damping(q, g),))


H, RC, C = 1e-4, 14e-6, 1e-6
FAULT = Event(5 * H, "G", 1 / 14)


def voltages(scheme, restart, engine=PythonInstance, **kwargs):
    """v after the fault, step by step, and the ledger."""
    stepper = Monolithic(build_model(decay(), scheme), engine(build_model(decay(), scheme)))
    result = run(stepper, Options(stop=12 * H, step=H, events=[FAULT], restart=restart, **kwargs))
    return result.column("q")[6:] / C, result


def test_gauss_nodes_ring_or_hang_after_a_fault():
    one, _ = voltages(Collocated(1), 0)
    two, _ = voltages(Collocated(2), 0)
    z = -H / RC
    assert one[:4] == pytest.approx(4e3 * stability(nodes(1), z) ** np.arange(1, 5), rel=1e-9)
    assert (np.sign(one[:4]) == [-1, 1, -1, 1]).all()
    assert abs(one[3]) > 390
    assert (np.diff(two) < 0).all()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("k", [1, 2])
def test_restart_steps_end_the_ringing_and_book_the_loss_once(engine, k):
    v, result = voltages(Collocated(k), 2, engine)
    z = -H / RC
    expected = 4e3 * stability(radau_nodes(2), z) ** np.arange(1, 3)
    assert v[:2] == pytest.approx(expected, rel=1e-9)
    assert np.abs(v[2:]).max() < 40
    assert result.restarted == 2
    (c,) = result.ledger.summary().components
    # 8 J on the capacitor, of which two Radau steps leave R^4: what the resistor did not take, they lost
    assert c.numerical + c.dissipated == pytest.approx(8.0 * (1 - (v[-1] / 4e3) ** 2), rel=1e-12)
    assert c.numerical > 0
    assert c.worst_relative < 1e-15


def test_the_loss_has_a_column_in_the_audit_and_is_absent_without_restarts(tmp_path):
    import pyarrow.parquet as pq

    from phfmu.audit import AuditWriter, audit_table, verdict

    for restart in (0, 2):
        with AuditWriter(str(tmp_path / f"{restart}.parquet"), {}) as writer:
            _, result = voltages(Collocated(1), restart, sink=writer)
        table = pq.read_table(tmp_path / f"{restart}.parquet")
        lost = [v for v in table["numerical"].to_pylist() if v] if "numerical" in table.column_names else []
        assert len(lost) == 2 * restart  # a component and a network row for each of the steps
        assert not verdict(table, 1e-13)
        assert ("lost by the scheme" in audit_table(result.ledger.summary())) is bool(restart)


def test_a_step_that_would_gain_energy_is_taken_by_the_exact_scheme():
    """A pendulum: H is not quadratic, and the Radau loss of a step can have either sign."""
    th, p = state("th", start=3.0), state("p", start=0.0)
    pendulum = PHDAE(
        "pendulum", states=(th, p), energies=(energy(1 - ca.cos(th)), energy(p**2 / 2)), structure=(skew(th, p, 1.0),)
    )
    lossy = PythonInstance(build_model(pendulum, Radau(2)))
    signs = set(np.sign(lossy.run(0.0, 0.5, 30, ("numerical",))["numerical"][:, 0]))
    assert signs == {-1.0, 1.0}
    model = build_model(pendulum, Collocated(1))
    stepper = Monolithic(model, PythonInstance(model))
    restart, losses = Restart(stepper), []
    for n in range(30):
        steps = restart.advance(0.5 * n, 0.5)
        losses.append(0.0 if steps.numerical is None else steps.numerical[0, 0])
    assert 0 < restart.refused < 30
    assert min(losses) >= 0.0


def test_an_instance_continues_from_one_of_another_scheme():
    model, other = build_model(build("dc_motor"), Collocated(2)), build_model(build("dc_motor"), Radau(2))
    for engine in ENGINES:
        a, b = engine(model), engine(other)
        a.set_input(model.u0 + 2.0)
        for n in range(3):
            a.do_step(1e-3 * n, 1e-3)
        b.continue_from(a)
        for name in ("x", "a", "energy", "supplied", "dissipated", "H"):
            assert np.array_equal(a.signal(name), b.signal(name))
        assert b.time == a.time
        b.do_step(b.time, 1e-3)
        assert b.signal("supplied") > a.signal("supplied")


def test_what_does_not_fit_says_what_does():
    four, motor = build("four_particle"), build("dc_motor")
    with pytest.raises(DeclarationError, match="two-level"):
        named_scheme(four, "radau")
    with pytest.raises(DeclarationError, match="1, 3 and 5"):
        named_scheme(motor, "radau", 4)
    with pytest.raises(DeclarationError, match="radau"):
        named_scheme(motor, "collocated", 3)
    assert named_scheme(motor, "radau").order == 3
    model = build_model(four)
    with pytest.raises(DeclarationError, match="--rtol"):
        run(Monolithic(model, PythonInstance(model)), Options(stop=1.0, step=0.1, restart=1))


def test_an_fmu_has_no_variable_for_the_loss(tmp_path):
    from phfmu import export
    from phfmu.fmu.export.export import FMUError

    motor = build("dc_motor")
    with pytest.raises(FMUError, match="loses energy"):
        export(build_model(motor, Radau(2)), tmp_path, step=1e-3)
