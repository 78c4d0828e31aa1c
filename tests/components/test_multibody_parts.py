"""Parts of the multibody builder: what they say, the forces they take, and what is refused."""

from __future__ import annotations

from time import process_time

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phfmu import (
    Collocated,
    PythonInstance,
    build_model,
    check,
    time,
)
from phfmu.components.mechanical.chain import chain
from phfmu.components.mechanical.multibody import Multibody
from tests.engines import ENGINES


def test_dampers_act_fully_or_along_their_line():
    for axial, lost in ((False, 2.0 * (0.25 + 4.0)), (True, 2.0 * 4.0)):
        body = Multibody("damped", 2)
        c = body.parameter("c", 2.0, unit="N.s/m")
        a, b = body.particle(1.0, (0, 0)), body.particle(1.0, (1, 0), (2.0, 0.5))
        body.damper(a, b, c, axial=axial)
        d = body.build()
        assert check(d) == []
        rows = PythonInstance(build_model(d)).run(0.0, 1e-7, 1, ("dissipated",))
        assert rows["dissipated"][0, 0] / 1e-7 == pytest.approx(lost, rel=1e-5)


@pytest.mark.parametrize("engine", ENGINES)
def test_driven_point_against_the_exact_motion(engine):
    """m x'' = k (s - x) + c (s' - x'), s' = 1 given: x = t - y, y the response of a damped oscillator."""
    body = Multibody("towed", 1)
    p, hook = body.particle(2.0, (0.0,)), body.driven_point("hook", (1.0,))
    body.linear_spring(p, hook, 8.0, 1.0)
    body.damper(p, hook, 1.5)
    d = body.build()
    assert check(d) == []
    instance = engine(build_model(d, Collocated(3)))
    instance.set_input(np.array([1.0]))
    rows = instance.run(0.0, 0.05, 20, ("x", "stored", "dissipated", "supplied"))
    assert np.max(np.abs(rows["stored"] + rows["dissipated"] - rows["supplied"])) <= 1e-14
    exact = solve_ivp(lambda t, y: [y[1], (8.0 * (t - y[0]) + 1.5 * (1 - y[1])) / 2.0], (0, 1), [0, 0], "DOP853",
                      rtol=1e-12, atol=1e-12).y[:, -1]  # fmt: skip
    q, v, s = rows["x"][-1]
    assert (q, v, s) == pytest.approx((*exact, 2.0), abs=1e-9)


def test_ports_take_forces_on_one_or_between_two_particles():
    body = Multibody("pushed", 2)
    a, b = body.particle(1.0, (0, 0)), body.particle(2.0, (1, 0))
    body.port("out", b)
    body.port("inside", b, a)
    instance = PythonInstance(build_model(body.build()))
    instance.set_input(np.array([2.0, 0.0, 0.0, 3.0]))
    instance.do_step(0.0, 0.5)
    assert instance.x[4:] == pytest.approx([0.0, -1.5, 0.5, 0.75], abs=1e-15)


def test_the_parts_say_what_the_declaration_is_made_of():
    """Momentum and kinetic energy of the listed masses are those of the declaration: dH/dv = m v, H = m v^2 / 2."""
    body = Multibody("two", dim=2)
    one = body.particle(2.0, (0.0, 1.0), (3.0, 0.0))
    two = body.particle(0.5, (1.0, 1.0), (0.0, -4.0), weight=False)
    body.bar(one, two)
    body.port("push", two)
    parts, built = body.parts, body.build()
    assert [m.weight for m in parts.masses] == [True, False] and parts.bars[0].points == (one, two)
    assert parts.ports == [("push", two, None)] and (parts.name, parts.dim, parts.gravity) == ("two", 2, None)
    q, v = built.states
    f = ca.Function(
        "f", [q.sx, v.sx, built.parameters[0].sx], [built.hamiltonian, ca.gradient(built.hamiltonian, v.sx)]
    )
    energy, momentum = (np.array(a).ravel() for a in f(q.start, v.start, built.parameters[0].start))
    assert np.array_equal(momentum, [m.mass * x for m in parts.masses for x in m.v])
    assert energy == sum(m.mass * x * x / 2 for m in parts.masses for x in m.v) == 13.0
    assert q.start == tuple(x for m in parts.masses for x in m.q)


def test_bad_parts_are_refused_by_name():
    body = Multibody("bad", 2)
    p = body.particle(1.0, (0, 0))
    hook, rail = body.driven_point("hook", (1, 1)), body.moving_support("rail", lambda t: (t, 0))
    other = body.moving_support("lift", lambda t: (0, t))
    for call, words in (
        (lambda: body.particle(-1.0, (0, 0)), "particle 2: mass -1.0 kg"),
        (lambda: body.particle(1.0, (0, 0, 0)), "particle 2: q needs 2 entries, got 3"),
        (lambda: body.bar(p, hook), "driven point 'hook'.*moving_support"),
        (lambda: body.linear_spring(p, rail, 1.0, 1.0), "moving support 'rail'.*driven_point"),
        (lambda: body.bar(p, body.particle(1.0, (0, 0))), "has length 0 m"),
        (lambda: Multibody("empty").build(), "empty: no particles"),
        (lambda: chain(0), "n = 0"),
    ):
        with pytest.raises(ValueError, match=words):
            call()
    body.constraint(lambda at: ca.sum1(at(rail) + at(other) + at(p)), "slot")
    with pytest.raises(ValueError, match="slot touches the moving supports rail, lift"):
        body.build()


def test_time_may_enter_a_constraint_directly():
    body = Multibody("cam", 2)
    p = body.particle(1.0, (0, 0), (0, 1.0))
    body.constraint(lambda at: at(p)[1] - ca.sin(time), drive="cam")
    instance = PythonInstance(build_model(body.build()))
    rows = instance.run(0.0, 0.1, 10, ("x", "supplied", "stored"))
    assert rows["x"][:, 1] == pytest.approx(np.sin(0.1 * np.arange(1, 11)), abs=1e-15)
    assert rows["x"][:, 3] == pytest.approx(np.cos(0.1 * np.arange(1, 11)), abs=1e-15)
    assert np.sum(rows["supplied"]) == pytest.approx((np.cos(1.0) ** 2 - 1) / 2, abs=1e-14)


@pytest.mark.slow
def test_declaration_time_grows_linearly():
    def seconds(n):
        start = process_time()
        build_model(chain(n, damping=0.1))
        return process_time() - start

    seconds(5)
    assert seconds(80) <= 8.0 * min(seconds(20) for _ in range(3))  # 4 if linear, 16 if quadratic


@pytest.mark.parametrize(
    ("g", "words"),
    [
        (lambda at, p: at(p)[2], r"crank: rail: .*out of bounds.*; at\(point\) is a column of 2 entries that count from 0: "
         r"\[0\] is x, \[1\] is y"),
        (lambda at, p: at(1)[1], r"crank: at\(1\): that is no point; give what particle\(\)"),
    ],
)  # fmt: skip
def test_positions_in_a_constraint_are_indexed_from_zero(g, words):
    body = Multibody("crank", dim=2)
    piston = body.particle(1.0, (2.0, 0.0))
    body.constraint(lambda at: g(at, piston), "rail")
    with pytest.raises(ValueError, match=words):
        body.build()
