"""Impulses at ports: which ports take them, their energy, and derivatives, against a member written a second time."""

from __future__ import annotations

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    Domain,
    NativeInstance,
    Network,
    Port,
    PythonInstance,
    StepFailure,
    block,
    build_model,
    damping,
    energy,
    skew,
    state,
)
from phfmu.components.library import build
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.translational import mass, spring
from tests.dense_member import DenseMember
from tests.engines import ENGINES
from tests.wide import wide

PUSH = Domain("push", "f", "N", "v", "m/s", "flow")


def body() -> PHDAE:
    """A mass with a damper on a quartic spring."""
    q, v = state("q", unit="m", start=0.4), state("v", unit="m/s", start=-0.3)
    energies = energy(2.0 * q.sx**2 + q.sx**4), energy(0.65 * v.sx**2)
    push = Port("flange", TRANSLATIONAL, "effort", {v: 1.0})
    return PHDAE("body", (q, v), energies=energies, E={v: 1.3}, structure=(skew(q, v, 1.0),),
                 dissipation=(damping(v, 0.2),), ports=(push,))  # fmt: skip


def stiffening() -> PHDAE:
    """A spring that is not quadratic in what its velocity input moves."""
    x = state("x", unit="m", start=0.2)
    end = Port("end", TRANSLATIONAL, "flow", {x: 1.0})
    return PHDAE("stiffening", (x,), energies=(energy(ca.cosh(1.5 * x.sx)),), ports=(end,))


def machine() -> PHDAE:
    return build("synchronous_machine")


def line() -> PHDAE:
    return build("rl_line")


def damped() -> PHDAE:
    return spring(30.0, d=2.0, elongation=-1.0)


#: declaration, step, sizes of inputs and impulses, ports that take a pair
CASES = {
    "body": (body, 0.2, 1.0, 0.1, ("flange",)),
    "stiffening": (stiffening, 0.2, 1.0, 0.0, ()),
    "line": (line, 1e-3, 10.0, 1e-3, ("a", "b")),
    "machine": (machine, 1e-3, 100.0, 1.0, ("terminal", "field", "shaft")),
    "damped": (damped, 0.05, 1.0, 0.0, ()),
}


@pytest.fixture(scope="module")
def members():
    made = {}

    def get(case, k):
        if (case, k) not in made:
            d = CASES[case][0]()
            made[case, k] = d, build_model(d, Collocated(k))
        return made[case, k]

    return get


def near(found, expected, accuracy=1e-12, size=None):
    expected = np.asarray(expected)
    size = np.abs(expected).max(initial=0.0) if size is None else size
    np.testing.assert_allclose(found, expected, rtol=0, atol=accuracy * size)


def drawn(case, model, seed=0):
    """Inputs at the nodes and impulses at both ends."""
    _, _, size, impulse, _ = CASES[case]
    rng = np.random.default_rng(seed)
    n = model.step.nu if impulse else 0
    return model.u0 + size * rng.normal(size=(model.step.k, model.step.nu)), impulse * rng.normal(size=(2, n))


# -- who takes them -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
def test_ports_say_what_they_offer_and_why_not(members, engine):
    def offers(d):
        return {p.port: (p.kind, p.linear, p.reason) for p in engine(build_model(d)).impulse_ports}

    bent, straight = ("pair", False, ""), ("pair", True, "")
    assert offers(machine()) == {"terminal": bent, "field": straight, "shaft": straight}
    assert offers(line()) == {"a": ("pair", True, ""), "b": ("pair", True, "")}
    assert offers(body()) == {"flange": ("pair", True, "")}
    assert offers(stiffening())["end"][:2] == ("end", False)
    assert offers(build("resistor"))["terminal"] == ("none", False, "it has feedthrough")
    assert offers(damped())["a"] == ("none", False, "its outputs contain algebraic variables")


def test_an_impulse_that_breaks_a_hidden_constraint_is_not_offered():
    """Velocities of particles with rigid bars, and a mass that is joined rigidly to another one."""
    net = Network("joined")
    net.add("a", mass(1.0))
    net.add("b", mass(2.0))
    net.junction("link", ["a.flange", "b.flange"])
    for d, name, B, broken in (
        (net.compose(), "a.v", 1.0, "an impulse on a.v would break the hidden constraint of a.flange.force"),
        (four_particle(), "v", np.eye(12)[:, 3], r"an impulse on v\[4\] would break the hidden constraint of lambda"),
    ):
        v = next(s for s in d.states if s.name == name)
        d = replace(d, ports=(*d.ports, Port("push", TRANSLATIONAL, "effort", {v: B})))
        (port,) = PythonInstance(build_model(d)).impulse_ports
        assert port.kind == "none" and re.match(broken, port.reason)


def test_coefficients_that_depend_on_what_an_impulse_moves_are_refused():
    x = state("x", start=1.0)
    bent = Port("bent", PUSH, "effort", {x: 1.0 + x.sx**2})
    (port,) = PythonInstance(build_model(PHDAE("d", (x,), energies=(energy(x.sx**2),), ports=(bent,)))).impulse_ports
    assert (port.kind, port.reason) == ("none", "coefficients depend on x, on which an impulse acts")


@pytest.mark.parametrize("engine", ENGINES)
def test_wrong_impulses_are_refused_with_names(members, engine):
    one = engine(members("line", 1)[1])
    for bad in ([1.0], np.full(6, np.nan), np.zeros(7)):
        with pytest.raises(ValueError, match=r"expected 6 finite impulses at start and end, for a.v\[1\], .* b.v\[3\]"):
            one.set_impulses(bad, np.zeros(6))
    one = engine(build_model(build("resistor")))
    with pytest.raises(ValueError, match=r"resistor: no port takes impulses \(terminal: it has feedthrough\)"):
        one.set_impulses([0.1], [0.0])
    assert one.jump().shape == (0, 0)


# -- the step -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
@pytest.mark.parametrize("case", CASES)
def test_steps_and_derivatives_equal_those_of_a_member_written_a_second_time(members, engine, case, k):
    """Two steps, of one and of three internal ones: states, node and end outputs, S, work, balance, derivatives."""
    (d, model), h, taken = members(case, k), CASES[case][1], CASES[case][4]
    one, dense, t = engine(model), DenseMember(d, k, taken), 0.0
    for seed, parts in enumerate((1, 3)):
        U, (s0, s1) = drawn(case, model, seed)
        one.set_node_inputs(U)
        if taken:
            one.set_impulses(s0, s1)
        one.do_step(t, h, parts)
        dense.step(t, h, U, s0 if taken else None, s1 if taken else None, parts)
        t += h
        near(one.x, dense.x)
        near(one.node_output(), dense.Y, 1e-11)
        near(one.signal("y_end")[dense.taken], dense.y1, 1e-11)
        S = one.node_sensitivity(impulses=bool(taken), end=True)
        nodes, x, end = dense.sensitivity()
        near(S.nodes, nodes, 1e-10)
        near(S.x, x, 1e-11)
        near(S.end[dense.taken], end, 1e-10)
        if taken:
            near(one.jump(), dense.jump())
        books = one.ledger()
        through = h * (model.step.weights @ (U * dense.Y))
        through[dense.taken] += dense.work
        near(books["pairs"][: model.step.nu], through, 1e-11)
        near(books["supplied"].sum(), through.sum() + dense.fed, 1e-11, np.abs(through).sum())
        near(books["stored"].sum(), dense.stored, 1e-11, np.abs(through).sum())
        near((books["stored"] + books["dissipated"] - books["supplied"]).sum(), 0.0, 1e-12, np.abs(through).sum())


@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
@pytest.mark.parametrize("case", ["machine", "body"])
def test_derivatives_equal_differences_with_rollback(members, case, k):
    """Of the native engine, over two internal steps, with impulses at both ends."""
    (_, model), h = members(case, k), CASES[case][1]
    one = NativeInstance(model)
    U, s = drawn(case, model)
    one.do_step(0.0, h)
    start = one.get_state()

    def values(point):
        one.set_state(start)
        one.set_node_inputs(point[: U.size].reshape(U.shape))
        one.set_impulses(*point[U.size :].reshape(s.shape))
        one.do_step(h, h, 2)
        return np.concatenate([one.node_output().ravel(), one.x, one.signal("y_end")[: model.step.nu]])

    point = np.concatenate([U.ravel(), s.ravel()])
    sizes = np.concatenate([np.full(U.size, CASES[case][2]), np.full(s.size, CASES[case][3])]) / 4
    columns = []
    for e in np.diag(sizes):
        a, b, c = ((values(point + f * e) - values(point - f * e)) / (2 * f * e.sum()) for f in (1.0, 0.5, 0.25))
        ab, bc = (4 * b - a) / 3, (4 * c - b) / 3
        columns.append((16 * bc - ab) / 15)
    values(point)
    S = one.node_sensitivity(impulses=True, end=True)
    found = np.vstack([S.nodes.reshape(U.size, -1), S.x, S.end])
    expected = np.array(columns).T
    scale = np.abs(expected).max(axis=1, keepdims=True) + 1e-9 * np.abs(expected).max()
    assert np.max(np.abs(found - expected) / scale) <= 1e-6
    chosen = one.node_sensitivity([0], impulses=True)
    np.testing.assert_array_equal(chosen.nodes[..., k:], S.nodes[..., U.size :])


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("case", ["machine", "body", "line"])
def test_the_work_of_impulses_is_the_change_of_the_stored_energy(members, engine, case):
    """s . (y + S s / 2) of a kick = H after - H before: steps so short that they do nothing else."""
    _, model = members(case, 1)
    _, (s, _) = drawn(case, model, 3)
    one = engine(model)
    h = 1e-9 * CASES[case][1]
    one.do_step(0.0, h)
    before = one.signal("H").sum()
    one.set_impulses(s, np.zeros(len(s)))
    one.do_step(h, h)
    booked, after = one.ledger(), one.signal("H").sum()
    # the step itself moves the power of the ports over h
    assert booked["stored"].sum() == pytest.approx(after - before, rel=1e-6, abs=1e-15 * abs(after) * 64)
    assert booked["moved"].sum() >= abs(booked["stored"].sum()) * (1 - 1e-12)


def test_of_an_energy_that_is_not_quadratic_the_work_is_the_integral():
    (end,) = (NativeInstance(build_model(stiffening())),)
    for one in (end, PythonInstance(build_model(stiffening()))):
        h, s = 1e-9, 0.3
        one.set_impulses([s], [0.0])
        one.do_step(0.0, h)
        assert one.ledger()["pairs"][0] == pytest.approx(np.cosh(1.5 * 0.5) - np.cosh(1.5 * 0.2), rel=1e-10)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
@pytest.mark.parametrize("case", ["machine", "body", "line"])
def test_there_and_back(members, engine, case, k):
    """The step back takes the inputs in turned order, and minus the impulses, the last one first."""
    (_, model), h = members(case, k), CASES[case][1]
    one = engine(model)
    start, steps = one.x, []
    for i in range(10):
        U, s = drawn(case, model, i)
        steps.append((U, s))
        one.set_node_inputs(U)
        one.set_impulses(*s)
        one.do_step(i * h, h)
    size = np.max(np.abs(one.x))
    assert np.max(np.abs(one.x - start)) > 1e-3 * size
    for i, (U, s) in reversed(list(enumerate(steps))):
        one.set_node_inputs(U[::-1])
        one.set_impulses(-s[1], -s[0])
        one.do_step((i + 1) * h, -h)
    near(one.x, start, 1e-12, size)


@pytest.mark.parametrize("engine", ENGINES)
def test_unset_and_zero_impulses_are_todays_bits(members, engine):
    _, model = members("machine", 2)
    untouched, zero, undone = (engine(model) for _ in range(3))
    n, h = model.step.nu, 1e-3
    undone.set_impulses(np.ones(n), np.ones(n))
    for i in range(3):
        zero.set_impulses(np.zeros(n), np.zeros(n))
        undone.set_impulses(np.zeros(n), -np.zeros(n))
        for one in (untouched, zero, undone):
            one.do_step(i * h, h)
    for one in (zero, undone):
        assert one.x.tobytes() == untouched.x.tobytes()
        assert one.signal("energy").tobytes() == untouched.signal("energy").tobytes()
        assert one.node_output().tobytes() == untouched.node_output().tobytes()


@pytest.mark.parametrize("engine", ENGINES)
def test_they_stay_until_set_and_belong_to_the_saved_state(members, engine):
    _, model = members("line", 1)
    one, h = engine(model), 1e-3
    plain = one.get_state()
    _, s = drawn("line", model)
    one.set_impulses(*s)
    one.do_step(0.0, h)
    saved = one.get_state()
    one.do_step(h, h)
    twice, sensitivity = one.x, one.node_sensitivity(impulses=True).x
    one.set_impulses(np.zeros(6), np.zeros(6))
    one.set_state(saved)
    one.do_step(h, h)
    assert one.x.tobytes() == twice.tobytes()
    np.testing.assert_array_equal(one.node_sensitivity(impulses=True).x, sensitivity)
    other = engine(model)
    other.set_state(saved)
    other.do_step(h, h)
    assert other.x.tobytes() == twice.tobytes()
    for again in (one, other):  # a state from before they were set has none
        again.set_state(plain)
        again.do_step(0.0, h)
    untouched = engine(model)
    untouched.do_step(0.0, h)
    assert one.x.tobytes() == other.x.tobytes() == untouched.x.tobytes()


@pytest.mark.parametrize("engine", ENGINES)
def test_steps_of_no_length_and_slivers_take_none(members, engine):
    _, model = members("line", 1)
    one, h = engine(model), 1e-3
    one.do_step(0.0, h)
    x = one.x
    one.set_impulses(np.ones(6), np.ones(6))
    one.do_step(h, 0.0)
    one.do_step(h, 1e-18)
    assert one.x.tobytes() == x.tobytes() and not one.ledger()["pairs"].any()


def growing() -> PHDAE:
    """x' = x^2 + u from 1 grows without bound in a second."""
    x = state("x", start=1.0)
    push = Port("push", PUSH, "effort", {x: 1.0})
    return PHDAE("grows", (x,), energies=(energy(0.5 * x.sx**2),), dissipation=(block((x,), -x.sx),), ports=(push,))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("parts", [1, 2])
def test_a_step_that_fails_takes_its_impulse_back(engine, parts):
    """To the bit, also what the compensated sum owes; and the step that is halved keeps it."""
    one, twin = (engine(build_model(growing())) for _ in range(2))
    for i in (one, twin):
        i.do_step(0.0, 0.1)
    x, energies = one.x, one.signal("energy")
    one.set_impulses([0.123456789], [0.2])
    with pytest.raises(StepFailure):
        one.do_step(0.1, 3.0, parts)
    assert one.x.tobytes() == x.tobytes() and one.signal("energy").tobytes() == energies.tobytes()
    assert one.time == 0.1
    for i in (one, twin):
        i.set_impulses([0.0], [0.0])
        for s in range(1, 4):
            i.do_step(0.1 * s, 0.1)
    assert one.x.tobytes() == twin.x.tobytes()


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("ends", [(1e200, 0.0), (0.0, 1e200)])
def test_an_impulse_whose_work_overflows_is_refused(engine, ends):
    one = engine(build_model(growing()))
    x = one.x
    one.set_impulses(*([v] for v in ends))
    with pytest.raises(StepFailure, match="a value is not finite"):
        one.do_step(0.0, 0.1)
    assert one.x.tobytes() == x.tobytes() and one.time == 0.0 and one.counts["steps"] == 0


@pytest.mark.parametrize("engine", ENGINES)
def test_runs_of_many_steps_take_no_impulses(engine):
    one = engine(build_model(growing()))
    one.set_impulses([0.1], [0.0])
    with pytest.raises(
        ValueError, match=r"grows: impulses belong to single steps \(do_step\); set them to 0 before run"
    ):
        one.run(0.0, 0.1, 2)
    one.set_impulses([0.0], [0.0])
    one.run(0.0, 0.1, 2)


@pytest.mark.parametrize("engine", ENGINES)
def test_derivatives_of_a_run_are_those_of_its_last_step(members, engine):
    """Impulses of an earlier step have no part in them, where coefficients depend on an angle."""
    one, twin = (engine(members("machine", 1)[1]) for _ in range(2))
    _, s = drawn("machine", one.model)
    one.set_impulses(*s)
    one.do_step(0.0, 1e-3)
    one.set_impulses(*(0.0 * s))
    one.run(1e-3, 1e-3, 2)
    before = one.x
    one.run(3e-3, 1e-3, 1)
    twin.set_x(3e-3, before)
    twin.initialise()
    twin.do_step(3e-3, 1e-3)
    near(one.node_sensitivity(impulses=True).x, twin.node_sensitivity(impulses=True).x, 1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_sliver_after_a_step_leaves_its_derivatives(members, engine):
    one, h = engine(members("machine", 1)[1]), 1e-3
    _, s = drawn("machine", one.model)
    one.set_impulses(*s)
    one.do_step(0.0, h)
    x = one.node_sensitivity(impulses=True).x
    one.do_step(h, 1e-18)
    np.testing.assert_array_equal(one.node_sensitivity(impulses=True).x, x)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_step_that_is_halved_takes_each_impulse_once(engine):
    one, h = engine(build_model(growing())), 0.4
    one.do_step(0.0, 0.4)
    before = one.x[0]
    s0, s1 = 0.01, -0.02
    one.set_impulses([s0], [s1])
    substeps = one.counts["substeps"]
    one.do_step(0.4, h)
    assert one.counts["substeps"] > substeps
    kicked = engine(build_model(growing()))
    kicked.set_x(0.4, [before + s0])
    kicked.initialise()
    for half in range(2):
        kicked.do_step(0.4 + half * h / 2, h / 2)
    assert one.x[0] == pytest.approx(kicked.x[0] + s1, rel=1e-12)
    work = s0 * (before + s0 / 2) + s1 * (one.x[0] - s1 / 2)
    assert one.ledger()["pairs"][0] == pytest.approx(work, rel=1e-12)


@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
@pytest.mark.parametrize("case", ["machine", "line"])
def test_both_engines_give_the_same(members, case, k):
    (_, model), h, found = members(case, k), CASES[case][1], []
    for one in (e(model) for e in ENGINES):
        for i in range(4):
            U, s = drawn(case, model, i)
            one.set_node_inputs(U)
            one.set_impulses(*s)
            one.do_step(i * h, h, 1 + i % 2)
        S = one.node_sensitivity(impulses=True, end=True)
        found.append((one.x, one.node_output(), one.signal("energy"), one.jump(), S.nodes, S.x, S.end))
    for a, b in zip(*found, strict=True):
        near(a, b, 1e-11)


def test_libraries_are_made_when_asked_for(members, monkeypatch):
    """Nothing of impulses is compiled, searched for or allocated in a model that does not use them."""
    from phfmu.engine import impulses

    searched = []
    monkeypatch.setattr(impulses, "port_kernels", lambda d: searched.append(d))
    for engine in ENGINES:
        one = engine(members("machine", 1)[1])
        one.do_step(0.0, 1e-3, 2)
        one.get_state()
        one.sensitivity()
    assert not searched
