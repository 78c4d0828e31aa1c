"""Moving constraints, velocities without mass, constraints of higher degree: exactness and orders."""

from __future__ import annotations

from functools import cache
from itertools import product

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    PHDAE,
    Collocated,
    DeclarationError,
    Holonomic,
    NativeInstance,
    Options,
    PythonInstance,
    TwoLevel,
    algebraic,
    build_model,
    check,
    energy,
    parameter,
    project_start,
    skew,
    state,
    strain_energy,
    time,
)
from tests.engines import ENGINES
from tests.wide import slow, wide

FIRST, THIRD = (TwoLevel(k) for k in (1, 3))
G, A, OMEGA = 9.81, 0.1, 5.0


def slopes(errors):
    return [float(np.log2(a / b)) for a, b in zip(errors, errors[1:], strict=False)]


# -- a pendulum on a support that moves up and down: q_s = A sin(w t) ----------------------------------------


@cache
def shaken(scheme):
    q, v = state("q", 2, unit="m", start=[1.0, 0.0]), state("v", 2, unit="m/s", start=[0.0, A * OMEGA])
    lam, m = algebraic("lambda", unit="N/m"), parameter("m", 2.0, unit="kg")
    g = 0.5 * (q[0] ** 2 + (q[1] - A * ca.sin(OMEGA * time)) ** 2 - 1.0)
    d = PHDAE(
        "shaken",
        states=(q, v),
        algebraics=(lam,),
        parameters=(m,),
        energies=(energy(0.5 * m * ca.sumsqr(v.sx)), energy(m * G * q[1])),
        E={v: ca.repmat(m.sx, 2)},
        structure=(skew(q, v, 1.0),),
        constraints=(Holonomic(lam, g),),
    )
    assert check(d) == []
    return build_model(d, scheme)


@cache
def shaken_reference():
    """q, v, lambda at 1 s and the work of the support, from the angle: th'' = -(g + q_s'') cos th."""

    def rhs(t, y):
        th, w, _ = y
        down = G - A * OMEGA**2 * np.sin(OMEGA * t)
        pull = 2.0 * (w**2 - down * np.sin(th))  # multiplier: m (w^2 - (g + q_s'') sin th)
        return [w, -down * np.cos(th), -pull * np.sin(th) * A * OMEGA * np.cos(OMEGA * t)]

    th, w, work = solve_ivp(rhs, (0.0, 1.0), [0.0, 0.0, 0.0], "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    q = [np.cos(th), A * np.sin(OMEGA) + np.sin(th)]
    v = [-w * np.sin(th), A * OMEGA * np.cos(OMEGA) + w * np.cos(th)]
    lam = 2.0 * (w**2 - (G - A * OMEGA**2 * np.sin(OMEGA)) * np.sin(th))
    return np.array(q), np.array(v), lam, work


@pytest.mark.parametrize(
    ("scheme", "order", "steps"), [slow((FIRST, 2.0, (320, 640, 1280))), (THIRD, 6.0, (20, 40, 80))]
)
def test_moving_support_has_exact_constraints_and_balance_and_full_order(scheme, order, steps):
    q, v, lam, work = shaken_reference()
    errors = []
    for n in steps:
        instance = NativeInstance(shaken(scheme))
        rows = instance.run(0.0, 1.0 / n, n, ("x", "stored", "supplied", "pairs", "signals"))
        assert np.max(np.abs(rows["signals"][:, instance.layout["observables"]])) <= 1e-14
        assert np.max(np.abs(rows["stored"] - rows["supplied"])) <= 1e-14
        assert (rows["pairs"] == rows["supplied"]).all()  # nothing but the drive does work
        x = rows["x"][-1]
        errors.append([
            np.linalg.norm(x[:2] - q), np.linalg.norm(x[2:] - v), abs(instance.signal("a_end")[0] - lam),
            abs(np.sum(rows["supplied"]) - work),
        ])  # fmt: skip
    for column in np.array(errors).T:
        assert all(abs(s - order) <= 0.15 for s in slopes(column)), column


def test_moving_support_in_both_engines_and_both_schemes():
    for scheme in (FIRST, THIRD, Collocated(1, name="semi-explicit")):
        one, two = (e(shaken(scheme)).run(0.0, 0.02, 20, ("x", "supplied", "stored")) for e in ENGINES)
        assert np.max(np.abs(one["x"] - two["x"])) <= 1e-12
        assert np.max(np.abs(one["stored"] - one["supplied"])) <= 1e-13
    drive = shaken(FIRST).declaration.port("lambda_drive")
    assert not drive.external and drive.domain.effort == "power"


# -- a point without mass between two particles ------------------------------------------------------------------


def carried(mass: float, bars: int = 2) -> PHDAE:
    """Particles 1 and 2 carry point 3 by bars; springs to supports and on the point without mass; planar."""
    q = state("q", 6, unit="m", start=[0.0, 0.0, 1.0, 0.0, 0.5, -0.8])
    v = state("v", 6, unit="m/s", start=[0.0, 0.0, 0.0, 0.5, 0.0, 0.0])
    m, lam = parameter("m", [1.0, 2.0, mass], 3, unit="kg"), algebraic("lambda", bars, unit="N/m")
    p, w = [q[0:2], q[2:4], q[4:6]], [v[0:2], v[2:4], v[4:6]]
    g = [0.5 * (ca.sumsqr(p[2] - p[i]) - 0.89) for i in range(bars)]
    ends = [(p[2], ca.DM([0, -2.0])), (p[0], ca.DM([-1.0, 1.0])), (p[1], ca.DM([2.0, 1.0])), (p[1], p[0])]
    terms = [energy(0.5 * m[i] * ca.sumsqr(w[i])) for i in range(3)]
    terms += [strain_energy(ca.sumsqr(a - b), lambda s: 10.0 * (s - 1.0) ** 2) for a, b in ends]
    return PHDAE(
        "carried",
        states=(q, v),
        algebraics=(lam,),
        parameters=(m,),
        energies=tuple(terms),
        E={v: ca.vertcat(*(m[i] for i in (0, 0, 1, 1, 2, 2)))},
        structure=(skew(q, v, 1.0),),
        constraints=(Holonomic(lam, ca.vertcat(*g)),),
    )


@cache
def started(mass: float) -> PHDAE:
    d = carried(mass)
    names = [n for s in d.states for n in s.names()]
    start = project_start(build_model(carried(0.0))).x
    return d.with_starts(dict(zip(names, map(float, start), strict=True)))


@cache
def carried_model(mass, scheme):
    return build_model(started(mass), scheme)


@cache
def carried_run(mass, scheme, n, stop=0.4):
    instance = NativeInstance(carried_model(mass, scheme))
    rows = instance.run(0.0, stop / n, n, ("x", "stored", "signals"))
    assert np.max(np.abs(rows["stored"])) <= 1e-13
    assert np.max(np.abs(rows["signals"][:, instance.layout["observables"]])) <= 1e-13
    return rows["x"]


@pytest.mark.parametrize(
    ("scheme", "order", "steps"), [(FIRST, 2.0, (160, 320, 640, 1280)), slow((THIRD, 6.0, (20, 40, 80, 160)))]
)
def test_a_point_without_mass_keeps_the_order_and_does_not_alternate(scheme, order, steps):
    ends = [carried_run(0.0, scheme, n)[-1] for n in steps]
    for part in (slice(0, 6), slice(6, 10), slice(10, 12)):
        errors = [np.linalg.norm((a - b)[part]) for a, b in zip(ends, ends[1:], strict=False)]
        assert all(abs(s - order) <= 0.15 for s in slopes(errors)), (part, errors)
    v3 = carried_run(0.0, scheme, steps[1])[:, 10:]
    second = np.abs(v3[2:] - 2 * v3[1:-1] + v3[:-2])
    assert np.max(second) <= 0.2 * np.max(np.abs(v3))  # an alternating mode would give 4 times its amplitude


@pytest.mark.parametrize("scheme", [FIRST, slow(THIRD)])
def test_no_mass_and_a_tiny_mass_move_alike(scheme):
    assert np.max(np.abs(carried_run(1e-15, scheme, 80) - carried_run(0.0, scheme, 80))) <= 1e-8


def test_python_engine_steps_without_mass():
    for scheme in (FIRST, THIRD):
        x = PythonInstance(build_model(started(0.0), scheme)).run(0.0, 0.005, 20, ("x",))["x"]
        assert np.max(np.abs(x - carried_run(0.0, scheme, 80)[:20])) <= 1e-11


def test_a_massless_direction_without_constraint_is_named():
    with pytest.raises(DeclarationError, match=r"M is singular on ker Dg.*v\[5\] = 0\.848, v\[6\] = 0\.53"):
        build_model(carried(0.0, bars=1))
    assert [p.rule for p in check(carried(0.0, bars=1))] == ["solvability"]
    assert check(started(0.0)) == []
    with pytest.raises(DeclarationError, match=r"v\[5\], v\[6\] without mass have no joint-gonzalez gradient"):
        build_model(started(0.0), TwoLevel(1, "joint-gonzalez"))


def test_work_of_moving_supports_stays_with_its_member_and_reaches_the_unit(tmp_path):
    from phfmu import FMUInstance, Monolithic, Network, export, run
    from phfmu.components.mechanical.multibody import Multibody

    def crane(reach):
        body = Multibody("crane", 2)
        body.gravity((0.0, -G))
        body.bar(body.moving_support("trolley", lambda t: (reach * t**2, 0.0)), body.particle(3.0, (0.0, -1.0)))
        return body.build()

    net = Network("two")
    net.add("near", crane(0.25))
    net.add("far", crane(0.5))
    model = build_model(net.compose())
    result = run(Monolithic(model, PythonInstance(model)), Options(stop=0.2, step=0.02))
    supplied = {(p.component, p.port): p.supplied for p in result.ledger.summary().ports}
    for member in ("near", "far"):
        stored = result.column(f"{member}.energy.stored")
        assert supplied[member, "trolley"] == pytest.approx(stored[-1] - stored[0], abs=1e-14)
    single = crane(0.5)
    (path,) = export(build_model(single), tmp_path, versions=("3.0",), step=0.02)
    unit = FMUInstance(path)
    for i in range(10):
        unit.do_step(0.02 * i, 0.02)
    assert unit.get(["trolley.energy"])[0] == pytest.approx(supplied["far", "trolley"], abs=1e-14)


# -- constraints that are not quadratic ----------------------------------------------------------------------------


def on_surface(kind: str) -> PHDAE:
    """Two beads on a quartic surface joined by a bar; one bead on a catenary."""
    from phfmu.components.mechanical.multibody import Multibody

    if kind == "catenary":
        body = Multibody(kind, 2)
        body.gravity((0.0, -G))
        p = body.particle(1.0, (0.6, np.cosh(0.6) - 1.0))
        body.constraint(lambda at: at(p)[1] - ca.cosh(at(p)[0]) + 1.0)
        return body.build()
    body = Multibody(kind, 3)
    body.gravity((0.0, 0.0, -G))

    def height(x, y):
        return 0.5 * x**2 + 0.25 * y**4 + 0.1 * x * y**2

    beads = [body.particle(m, (x, y, height(x, y))) for m, x, y in ((1.0, 0.9, 0.3), (2.0, -0.4, 0.7))]
    for p in beads:
        body.constraint(lambda at, p=p: at(p)[2] - height(at(p)[0], at(p)[1]))
    body.bar(*beads)
    return body.build()


@pytest.mark.parametrize("kind", ["quartic", "catenary"])
@pytest.mark.parametrize(("scheme", "order", "steps"), [(FIRST, 2.0, (80, 160, 320)), slow((THIRD, 6.0, (10, 20, 40)))])
def test_constraints_of_any_degree_are_exact_and_keep_the_order(kind, scheme, order, steps):
    model, ends = build_model(on_surface(kind), scheme), []
    for n in steps:
        instance = NativeInstance(model)
        rows = instance.run(0.0, 0.6 / n, n, ("x", "stored", "signals"))
        assert np.max(np.abs(rows["stored"])) <= 1e-14
        assert np.max(np.abs(rows["signals"][:, instance.layout["observables"]])) <= 1e-14
        ends.append(rows["x"][-1])
    errors = [np.linalg.norm(a - b) for a, b in zip(ends, ends[1:], strict=False)]
    assert abs(slopes(errors)[0] - order) <= 0.2, errors


GRADIENTS = ("per-term", "mean-value", "joint-gonzalez", "itoh-abe", "itoh-abe-symmetric")


@pytest.mark.parametrize(
    ("form", "gradient"),
    wide(
        product((TwoLevel, Collocated), GRADIENTS),
        *((TwoLevel, "per-term"), (TwoLevel, "itoh-abe-symmetric"), (Collocated, "joint-gonzalez")),
    ),
)
def test_every_gradient_takes_large_steps_of_four_particles(form, gradient):
    from phfmu.components.mechanical.four_particle import four_particle

    model = build_model(four_particle(), form(1, gradient=gradient))
    for h in (0.1, 0.25, 0.4):
        rows = NativeInstance(model).run(0.0, h, round(10.0 / h), ("energy", "stored", "dissipated"))
        assert np.max(np.abs(rows["stored"] + rows["dissipated"])) <= 1e-12
        assert np.max(np.diff(rows["energy"][:, 0])) <= 1e-13
