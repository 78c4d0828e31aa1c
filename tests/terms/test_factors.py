"""Blocks of R with a factor: R = G^T W G acts by the rates G z, and its entries are never formed."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    ELECTRICAL,
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    DeclarationError,
    FMUInstance,
    NativeInstance,
    Network,
    Port,
    PythonInstance,
    SystemTransformation,
    block,
    build_model,
    check,
    default_scheme,
    energy,
    export,
    observable,
    parameter,
    signal_input,
    signal_output,
    skew,
    state,
    strain_energy,
)
from phfmu.checks.sample import Sample
from phfmu.components.mechanical.chain import chain
from phfmu.components.mechanical.multibody import Multibody
from phfmu.declare.entries.entries import Entries, normal_form
from phfmu.declare.variable import ValueKind
from phfmu.discretise.accounts import by_term
from phfmu.terms.extraction.extract import extract
from phfmu.terms.term import FLOW
from tests.engines import ENGINES

MASS, K, LENGTH, C = (2.0, 1.0), 30.0, 1.0, 0.7
Q, V = (0.0, 0.0, 1.2, 0.1), (0.1, -0.5, -0.2, 1.5)


def pair(form: str = "factor", *, c: float = C, signal: bool = False) -> PHDAE:
    """Two particles in the plane on a spring with a damper along the line between them; `form`: of its block."""
    q, v = state("q", 4, unit="m", start=Q), state("v", 4, unit="m/s", start=V)
    m, k = parameter("m", MASS, 2, unit="kg"), parameter("k", K, unit="N/m")
    d = signal_input("c", c, unit="N.s/m") if signal else parameter("c", c, unit="N.s/m")
    apart = q[2:] - q[:2]
    row, square = ca.horzcat(-apart.T, apart.T), ca.sumsqr(apart)
    weights = ca.vertcat(m[0], m[0], m[1], m[1])
    given = (
        block([v], d / square, factor=row) if form == "factor" else block([v], ca.mtimes(row.T, row) * d.sx / square)
    )
    return PHDAE(
        "pair",
        states=(q, v),
        parameters=(m, k, d),
        energies=(
            energy(ca.dot(weights, v.sx**2) / 2),
            strain_energy(square, lambda s: k.sx / 2 * (ca.sqrt(s) - LENGTH) ** 2),
        ),
        E={v: weights},
        structure=(skew(q, v, 1.0),),
        dissipation=(given,),
        ports=(Port("hand", TRANSLATIONAL, "effort", {v: [0.0, 0.0, 1.0, 0.0]}),),
        observables=(observable("r", ca.sqrt(square), unit="m"),),
    )


def exact(t: float) -> tuple[float, float, float]:
    """Distance, its rate, and what the damper took, of mu r'' = L^2/(mu r^3) - k (r - l) - c r'."""
    mu = MASS[0] * MASS[1] / sum(MASS)
    d, u = np.subtract(Q[2:], Q[:2]), np.subtract(V[2:], V[:2])
    r = float(np.hypot(*d))
    momentum = mu * float(d[0] * u[1] - d[1] * u[0])

    def rates(_: float, y: np.ndarray) -> list[float]:
        return [y[1], momentum**2 / (mu**2 * y[0] ** 3) - (K * (y[0] - LENGTH) + C * y[1]) / mu, C * y[1] ** 2]

    return tuple(solve_ivp(rates, (0, t), [r, float(d @ u) / r, 0.0], "DOP853", rtol=1e-13, atol=1e-14).y[:, -1])


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("order", [2, 4, 6])
def test_a_damper_of_factors_against_polar_coordinates(engine, order):
    """Distance, rate and loss have the order of the scheme; every step closes, and no step dissipates less than nothing."""
    expected, errors = np.array(exact(1.0)), []
    for n in (20, 40):
        instance = engine(build_model(pair(), Collocated(order // 2)))
        rows = instance.run(0.0, 1.0 / n, n, ("x", "stored", "dissipated"))
        assert np.max(np.abs(rows["stored"] + rows["dissipated"])) <= 1e-13
        assert rows["dissipated"].min() >= 0.0
        q, v = rows["x"][-1][:4], rows["x"][-1][4:]
        d, u = q[2:] - q[:2], v[2:] - v[:2]
        r = np.hypot(*d)
        errors.append(np.abs(np.array([r, d @ u / r, rows["dissipated"].sum()]) - expected).max())
    assert errors[1] < 1e-2 and np.log2(errors[0] / errors[1]) > order - 0.5


@pytest.mark.parametrize("order", [2, 4, 6])
def test_factors_give_the_steps_of_the_entries(order):
    runs, sizes = [], []
    for form in ("factor", "entries"):
        model = build_model(pair(form), Collocated(order // 2))
        sizes.append(sum(g.kernel.function.n_instructions() for g in model.step.groups))
        runs.append(PythonInstance(model).run(0.0, 0.05, 20, ("x", "dissipated")))
    assert sizes[0] < sizes[1]
    for what, size in (("x", 2.0), ("dissipated", 0.1)):
        assert np.abs(runs[0][what] - runs[1][what]).max() <= 1e-12 * size


def losses(form: str) -> np.ndarray:
    """z^T R z at random points whose velocities hardly change the distance."""
    terms = extract(pair(form))
    (term,) = (t for t in terms.of(FLOW) if "loss" in t.data)
    loss = ca.Function("loss", [*term.local.values()], [term.data["loss"]])
    rng, found = np.random.default_rng(2), []
    for _ in range(500):
        q, z = rng.uniform(-1, 1, 4), rng.uniform(-1, 1, 4)
        g = np.array([*(q[:2] - q[2:]), *(q[2:] - q[:2])])
        z -= g * (g @ z) / (g @ g)
        # positions are the first states, velocities and their costates the others; c is the last parameter
        values = {ValueKind.STATE: [*q, *z], ValueKind.COSTATE: [*q, *z], ValueKind.PARAMETER: [1.0, 1.0, 1.0, C]}
        found.append(float(loss(*([values[kind][i] for i in term.index[kind]] for kind in term.local))))
    return np.array(found)


def test_the_power_of_factors_is_not_negative_where_that_of_entries_rounds_below_zero():
    assert losses("factor").min() >= 0.0
    assert losses("entries").min() < 0.0


def test_a_negative_coefficient_between_factors_is_refused_by_name():
    (found,) = (p for p in check(pair(c=-0.5)) if p.rule == "passivity")
    assert "R block on v" in found.entry and "eigenvalue -" in found.reason
    x, f = state("x", 4), parameter("f", 0.3)
    rows = ca.horzcat(ca.SX.eye(2), f.sx * ca.SX.ones(2, 2))
    indefinite = PHDAE(
        "two_rates", states=(x,), parameters=(f,), energies=(energy(ca.sumsqr(x.sx) / 2),),
        dissipation=(block([x], ca.DM([[1.0, 2.0], [2.0, 1.0]]), factor=rows),),
    )  # fmt: skip
    (found,) = (p for p in check(indefinite) if p.rule == "passivity")
    # the eigenvector (1, -1) of -1 meets the rows (1, 0, f, f) and (0, 1, f, f) in (1, -1, 0, 0)
    assert "R block on x" in found.entry and "eigenvalue -1," in found.reason


@pytest.mark.parametrize("factor, value", [(np.ones((1, 3)), 1.0), (np.ones((2, 4)), np.ones((3, 3)))])
def test_factors_that_do_not_fit_are_refused(factor, value):
    with pytest.raises(DeclarationError, match=r"block on x: its factor is \d x \d and its matrix .* 4 columns"):
        block([state("x", 4)], value, factor=factor)


def test_a_number_between_factors_is_that_multiple_of_the_identity():
    given = block([state("x", 3)], 2.0, factor=np.array([[1.0, 0.0, 1.0], [0.0, 1.0, -1.0]]))
    assert np.array_equal(ca.DM(given.matrix).full(), 2.0 * np.array([[1, 0, 1], [0, 1, -1], [1, -1, 2]]))
    assert np.array_equal(given.pattern.full() != 0, np.array([[1, 0, 1], [0, 1, 1], [1, 1, 1]], bool))


def test_entries_are_formed_where_they_are_no_more_than_the_factors():
    """The damper of a link acts on each axis alone: 12 entries, as many in the factor and its transpose and three between."""
    d = chain(3, damping=0.5)
    terms = [t for t in extract(d).of(FLOW) if "loss" in t.data]
    assert all(b.factor is not None for b in d.dissipation) and len(terms) == 9
    assert all(len(t.rows) <= 2 for t in terms)


def test_new_coordinates_keep_the_factor():
    """Of the sum and the difference of both velocities, the damper reads the difference alone."""
    model = pair()
    v = model.states[1]
    s, w = state("s", 2, unit="m/s"), state("w", 2, unit="m/s")
    back = {v: ca.vertcat(s.sx - w.sx / 2, s.sx + w.sx / 2)}
    new = SystemTransformation(back, (s, w), U=ca.jacobian(back[v], ca.vertcat(s.sx, w.sx)))(model)
    (given,) = new.dissipation
    assert given.factor is not None and [v.name for v in given.variables] == ["s", "w"]
    assert given.factor[:, :2].nnz() == 0 and given.factor[:, 2:].nnz() == 2
    old, now = (PythonInstance(build_model(d)).run(0.0, 0.05, 10, ("x", "dissipated")) for d in (model, new))
    assert np.abs(now["dissipated"] - old["dissipated"]).max() <= 1e-13
    assert np.abs(now["x"][:, :4] - old["x"][:, :4]).max() <= 1e-12


@pytest.mark.parametrize("order", [2, 6])
def test_a_signal_sets_the_coefficient(order):
    """Fed by another member, as the entries are."""
    ends = []
    for form in ("factor", "entries"):
        net = Network("fed")
        net.add("pair", pair(form, signal=True))
        x = state("x", start=0.4)
        told = signal_output("level", 1.0 + x.sx, unit="N.s/m")
        net.add("source", PHDAE("source", states=(x,), energies=(energy(x.sx**2 / 2),), observables=(told,)))
        net.signal("source.level", "pair.c")
        whole = net.compose()
        assert (whole.dissipation[0].factor is not None) is (form == "factor")
        ends.append(PythonInstance(build_model(whole, Collocated(order // 2))).run(0.0, 0.05, 10, ("x",))["x"][-1])
    assert np.abs(ends[0] - ends[1]).max() <= 1e-12


def test_a_damper_of_factors_has_its_account():
    assert ":R(c)" in by_term(pair()).members
    rows = PythonInstance(build_model(by_term(pair()))).run(0.0, 0.05, 10, ("dissipated",))["dissipated"]
    whole = PythonInstance(build_model(pair())).run(0.0, 0.05, 10, ("dissipated",))["dissipated"]
    assert np.abs(rows.sum(axis=1) - whole[:, 0]).max() <= 1e-13


def test_ports_between_factors_are_feedthrough():
    """A resistor across the weighted sum of three voltages: i = G^T W G u, against numbers."""
    x = state("x", 1, start=0.5)
    ports = [Port(f"p{i}", ELECTRICAL, "effort", {}, start=u) for i, u in enumerate((1.0, -2.0, 0.5))]
    row = ca.horzcat(1.0 + x[0] ** 2, -2.0 * x[0], 3.0)
    d = PHDAE(
        "weighted", states=(x,), energies=(energy(x.sx**2 / 2),), ports=tuple(ports),
        dissipation=(block(ports, 0.2, factor=row),),
    )  # fmt: skip
    g, u = np.array([1.25, -1.0, 3.0]), np.array([1.0, -2.0, 0.5])
    for engine in ENGINES:
        instance = engine(build_model(d))
        rows = instance.run(0.0, 0.1, 1, ("dissipated", "supplied"))
        assert instance.output() == pytest.approx(0.2 * g * (g @ u), rel=1e-14)
        assert rows["dissipated"][0, 0] == pytest.approx(0.1 * 0.2 * (g @ u) ** 2, rel=1e-13)
        assert rows["supplied"][0].sum() == pytest.approx(rows["dissipated"][0, 0], rel=1e-13)


def test_what_is_checked_is_the_product():
    entries = Entries(pair())
    normal_form(entries)
    other = Entries(pair("entries"))
    normal_form(other)
    (a,), (b,) = ([e for e in found.sound if e.label == "R block on v"] for found in (entries, other))
    np.testing.assert_allclose(Sample(entries).of([a])[0], Sample(other).of([b])[0], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("order", [2, 6])
def test_units_step_as_the_native_engine(order, tmp_path: Path):
    model = build_model(pair(), Collocated(order // 2))
    native, h = NativeInstance(model), 0.02
    u = np.sin(np.arange(25.0))
    rows = native.run(0.0, h, 25, ("x",), inputs=u[:, None])["x"]
    paths = export(model, tmp_path, step=h)
    assert len(paths) == 2
    for path in paths:
        with FMUInstance(path) as unit:
            for k in range(25):
                unit.set({"hand.force": u[k]})
                unit.do_step(k * h, h)
            names = [f"{n}[{i + 1}]" for n in ("q", "v") for i in range(4)]
            assert np.array_equal(unit.get(names), rows[-1])


def test_the_builder_hands_over_the_factor_of_an_axial_damper():
    """It loses d r'^2 a second."""
    body = Multibody("damped", 3)
    a, b = body.particle(1.0, (0, 0, 0)), body.particle(1.0, (1, 2, 2), (2.0, 0.5, -1.0))
    body.damper(a, b, 2.0, axial=True)
    d = body.build()
    factor = d.dissipation[0].factor
    assert factor is not None and factor.shape == (1, 6)
    rows = PythonInstance(build_model(d, default_scheme(d))).run(0.0, 1e-7, 1, ("dissipated",))
    assert rows["dissipated"][0, 0] / 1e-7 == pytest.approx(2.0 * ((2.0 + 1.0 - 2.0) / 3) ** 2, rel=1e-5)
