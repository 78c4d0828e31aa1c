"""Observed orders: slopes of the error against the step, with independent solutions as references."""

from __future__ import annotations

from functools import cache
from itertools import product

import casadi as ca
import numpy as np
import pytest
from reference_tools import read
from scipy.integrate import solve_ivp

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    NativeInstance,
    Port,
    PythonInstance,
    TwoLevel,
    algebraic,
    block,
    build_model,
    damping,
    energy,
    skew,
    state,
    time,
)
from phfmu.components.electrical import rlc_load
from phfmu.components.library import build
from tests.engines import ENGINES
from tests.wide import wide

TOLERANCE = {1: 0.1, 2: 0.15, 3: 0.25}


#: the columns of reference/<name>.csv
reference = cache(read)


def slope(steps, errors):
    """Exponent of errors ~ steps^slope by linear regression."""
    assert min(errors) > 0.0
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


# -- index 1: nonlinear capacitor, inductor, resistor whose law depends on its own current -----------------

BETA, L, R, G, I0, END = 0.5, 0.8, 0.3, 0.4, 0.5, 2.0
START = (0.9, -0.4)


def drive(t, sin=np.sin, cos=np.cos):
    return 1.2 * sin(3.0 * t) + 0.7 * cos(1.1 * t + 0.4)


def rlc(driven: str, law: str) -> PHDAE:
    """q' = phi/L - i, phi' = u - v - R phi/L, 0 = v - r i; H = q^2/2 + beta q^4/4 + phi^2/(2 L), v = H_q.

    `law`: r(i) = G + i^2/2 ("algebraic"), or r(q) = G + q^2 ("state").
    """
    q, phi = state("q", unit="C", start=START[0]), state("phi", unit="Wb", start=START[1])
    i = algebraic("i", unit="A", start=I0)
    r = G + (i**2 / 2 if law == "algebraic" else q**2)
    fed = ca.SX(drive(time, ca.sin, ca.cos)) if driven == "source" else None
    return PHDAE(
        "rlc",
        states=(q, phi),
        algebraics=(i,),
        energies=(energy(q**2 / 2 + BETA * q**4 / 4), energy(phi**2 / (2 * L))),
        structure=(skew(q, phi, 1.0), skew(q, i, -1.0)),
        dissipation=(damping(phi, R), block([i], r)),
        ports=(Port("terminal", ELECTRICAL, "effort", {phi: 1.0}, source=fed),),
    )


def rlc_rate(law):
    """x' of the same circuit with the resistor's current in closed form."""

    def current(v, q):
        if law == "state":
            return v / (G + q**2)
        a = np.cbrt(v + np.sqrt(v**2 + (2 * G / 3) ** 3))  # Cardano: i^3/2 + G i = v
        return a - 2 * G / 3 / a

    def rate(t, x):
        q, phi = x
        v = q + BETA * q**3
        return [phi / L - current(v, q), drive(t) - v - R * phi / L]

    return rate


@cache
def rlc_exact(law):
    run = solve_ivp(rlc_rate(law), (0.0, END), START, method="DOP853", rtol=3e-14, atol=1e-15, max_step=0.01)
    return run.y[:, -1]


STEPS = {1: (14, 20, 28, 40, 57), 2: (14, 20, 28, 40), 3: (20, 28, 40)}


@pytest.mark.parametrize(
    ("k", "driven", "law"),
    wide(
        product((1, 2, 3), ("source", "nodes"), ("algebraic", "state")),
        *((1, "source", "algebraic"), (2, "nodes", "algebraic"), (2, "source", "state"), (3, "nodes", "state")),
    ),
)
def test_index_one_circuit_has_order_2k_and_an_exact_balance(k, driven, law):
    model = build_model(rlc(driven, law), Collocated(k))
    instance, errors = PythonInstance(model), []
    for n in STEPS[k]:
        instance.reset()
        h = END / n
        for s in range(n):
            if driven == "nodes":
                instance.set_node_inputs(drive(h * (s + model.nodes))[:, None])
            instance.do_step(s * h, h)
            row = instance.ledger()
            total = np.sum([row["stored"], row["dissipated"], -row["supplied"]])
            assert abs(total) <= 1e-13 * sum(np.sum(np.abs(row[name])) for name in row)
        errors.append(np.max(np.abs(instance.x - rlc_exact(law))))
    assert slope([END / n for n in STEPS[k]], errors) == pytest.approx(2 * k, abs=TOLERANCE[k])


def test_inputs_held_over_the_step_limit_the_order_to_two():
    """With the node values replaced by their mean every k has order 2; the balance stays exact."""
    model = build_model(rlc("nodes", "algebraic"), Collocated(2))
    instance, errors, steps = PythonInstance(model), [], (20, 40, 80)
    for n in steps:
        instance.reset()
        h = END / n
        means = [[model.step.weights @ drive(h * (s + model.nodes))] for s in range(n)]
        rows = instance.run(0.0, h, n, ("x", "stored", "dissipated", "supplied"), inputs=means)
        assert np.max(np.abs(rows["stored"] + rows["dissipated"] - rows["supplied"])) <= 1e-14
        errors.append(np.max(np.abs(rows["x"][-1] - rlc_exact("algebraic"))))
    assert slope(steps, errors) == pytest.approx(-2.0, abs=0.1)


@pytest.mark.parametrize("engine", ENGINES)
def test_parts_of_a_step_resample_the_node_inputs(engine):
    """Inner steps see the polynomial through the node inputs: order 2k holds with a fixed number of parts."""
    model, errors, steps = build_model(rlc("nodes", "state"), Collocated(2)), [], (10, 20, 40)
    for n in steps:
        instance, h = engine(model), END / n
        for s in range(n):
            instance.set_node_inputs(drive(h * (s + model.nodes))[:, None])
            instance.do_step(s * h, h, parts=3)
        errors.append(np.max(np.abs(instance.x - rlc_exact("state"))))
    assert slope(steps, errors) == pytest.approx(-4.0, abs=0.15)


@pytest.mark.parametrize("engine", ENGINES)
def test_end_values_see_the_polynomial_through_the_node_inputs(engine):
    """i(t + h) of a resistor and an inductor at u(t) = 1 + t: the input at the end is extrapolated, not held."""
    model, h = build_model(rlc_load(2.0, 0.01), Collocated(2)), 1e-3
    instance = engine(model)
    instance.set_node_inputs(np.tile(1.0 + h * model.nodes[:, None], 3))
    instance.do_step(0.0, h)
    expected = (1.0 + h) / 2.0 + (h + h**2 / 2) / 0.01
    assert instance.signals()["y_end"] == pytest.approx(np.full(3, expected), rel=1e-12)


# -- linear drive against the matrix exponential ------------------------------------------------------------


DRIVE_STEPS = {
    1: (1e-4, 5e-5, 4e-5, 2.5e-5, 2e-5),
    2: (2e-4, 1.25e-4, 1e-4, 5e-5),
    3: (5e-4, 3.125e-4, 2.5e-4, 2e-4),
}


@pytest.mark.parametrize(("k", "steps"), DRIVE_STEPS.items())
def test_drive_converges_to_the_matrix_exponential(k, steps):
    exact = reference("drive")
    model = build_model(build("drive").declaration(), Collocated(k))
    names = [n for v in model.declaration.states for n in v.names()]
    # the shaft of the scene twists from a to b, the reference the other way round
    scale = {"motor.flux": 1 / 2e-3, "motor.w": 1.0, "shaft.twist": -1.0, "load.w": 1.0}
    columns = dict(zip(scale, ("i", "w1", "twist", "w2"), strict=True))
    errors = {name: [] for name in scale}
    for h in steps:
        per_row = round(0.005 / h)
        x = NativeInstance(model).run(0.0, h, 20 * per_row, ("x",))["x"][per_row - 1 :: per_row]
        for name, column in columns.items():
            difference = scale[name] * x[:, names.index(name)] - exact[column][1:]
            errors[name].append(np.max(np.abs(difference)) / np.max(np.abs(exact[column])))
    for name, values in errors.items():
        assert slope(steps, values) == pytest.approx(2 * k, abs=TOLERANCE[k]), name
        assert values[-1] <= (2e-3 if k == 1 else 1e-6)


# -- holonomic constraints ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("k", "steps", "bound"),
    [(1, (1 / 800, 1 / 1600, 1 / 3200), 0.1), (3, (1 / 25, 1 / 40, 1 / 50, 1 / 80, 1 / 100), 0.15)],
)
def test_four_particle_two_level_has_order_2k_in_positions_and_velocities(k, steps, bound):
    exact = reference("four_particle")
    assert exact["time"][-1] == 1.0
    model = build_model(build("four_particle"), TwoLevel(k))
    errors = {"q": [], "v": []}
    for h in steps:
        x = NativeInstance(model).run(0.0, h, round(1 / h), ("x",))["x"][-1]
        for name, values in (("q", x[:12]), ("v", x[12:])):
            final = np.array([exact[f"{name}[{j + 1}]"][-1] for j in range(12)])
            errors[name].append(np.linalg.norm(values - final))
    for name, values in errors.items():
        assert slope(steps, values) == pytest.approx(2 * k, abs=bound), (name, values)
