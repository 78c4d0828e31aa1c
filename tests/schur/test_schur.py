"""The Schur stepper: recognised where its form holds, and the same solution as the sparse Newton of the readable engine."""

from __future__ import annotations

import ctypes
from itertools import product

import casadi as ca
import numpy as np
import pytest

from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.mechanisms.slider_crank import slider_crank
from phfmu.components.mechanical.multibody import Multibody
from phfmu.discretise.model import Model, build_model, default_scheme
from phfmu.engine.build.codegen import kernel_table
from phfmu.engine.build.compile import compile, host_flags
from phfmu.engine.build.runtime_sources import runtime_sources
from phfmu.engine.build.tables import CTables
from phfmu.engine.model import kernels
from phfmu.engine.native.library import load
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.reference.python import PythonInstance
from phfmu.gradients.quadrature import nodes
from phfmu.schemes.collocated import Collocated
from phfmu.schur import lane_groups, text
from phfmu.schur.elimination import eliminate
from phfmu.schur.lanes import spectrum
from tests.wide import slow, wide

#: the stepper of order 2 is a case of that of order 6, with one node
ORDERS = (pytest.param(2, marks=pytest.mark.slow), 6)


def chain(n: int, springs: float = 50.0) -> Multibody:
    """n links of 1 m on a support, horizontal at the start, quartic springs between every other joint, gravity."""
    body = Multibody("chain", dim=3)
    body.gravity((0.0, 0.0, -9.81))
    points = [body.support((0.0, 0.0, 0.0))]
    points += [body.particle(1.0 + 0.1 * i, (i + 1.0, 0.0, 0.0), (0.0, 0.1 * (-1) ** i, 0.0)) for i in range(n)]
    for a, b in zip(points, points[1:], strict=False):
        body.bar(a, b)
    for a, b in zip(points, points[2:], strict=False):
        body.quartic_spring(a, b, springs, 2.0)
    return body


def pushed() -> Multibody:
    """A bar on a port, tied to the ground by a spring of given length and a damper that feels one velocity only."""
    body = Multibody("pushed")
    a = body.particle(1.0, (0.0, 0.0, 0.0))
    b = body.particle(2.0, (1.0, 0.0, 0.0), (0.0, 0.3, 0.0))
    ground = body.support((0.0, -1.0, 0.5))
    body.bar(a, b)
    body.spring(ground, b, lambda c: 20.0 * (ca.sqrt(c) - 1.0) ** 2)
    body.damper(ground, a, lambda c: 0.4 + 0.1 * c)
    body.port("hand", a)
    return body


def charges(as_springs: bool) -> Multibody:
    """Three particles on circles about the origin that repel each other, by springs or by one potential of them all."""
    body = Multibody("charges")
    c = body.parameter("c", 0.7, unit="J")
    centre = body.support((0.0, 0.0, 0.0))
    points = [body.particle(1.0 + i, (np.cos(i), np.sin(i), 0.2 * i), (-np.sin(i), np.cos(i), 0.0)) for i in range(3)]
    pairs = [(a, b) for i, a in enumerate(points) for b in points[:i]]
    for p in points:
        body.bar(centre, p)
    if as_springs:
        for a, b in pairs:
            body.spring(a, b, lambda s: -0.5 * c.sx * ca.log(s))
    else:
        body.potential(lambda at: -0.5 * c.sx * sum(ca.log(ca.sumsqr(at(a) - at(b))) for a, b in pairs))
    return body


def model(body: Multibody, order: int) -> Model:
    declaration = body.build()
    return build_model(declaration, default_scheme(declaration, order))


@pytest.mark.parametrize("order", ORDERS)
def test_a_potential_of_distances_takes_the_fast_stepper(order: int, compiler: None) -> None:
    """It is the springs it is made of."""
    one, many = (model(charges(springs), order) for springs in (False, True))
    assert one.step.schur is not None and one.step.schur.nstrain == 3
    ends = []
    for m in (one, many):
        unit = NativeInstance(m)
        unit.run(0.0, 0.01, 100)
        assert unit.counts["schur"] == 100
        ends.append(unit.x)
    assert np.abs(ends[0] - ends[1]).max() <= 1e-13


BODIES = {"chain": lambda: chain(4), "stiff chain": lambda: chain(4, 1e5), "pushed": pushed}


@pytest.mark.parametrize(
    ("name", "order"),
    wide(product(("chain", "stiff chain", "pushed"), (2, 6)), ("chain", 2)),
)
def test_the_schur_stepper_finds_the_solution_of_newton(name: str, order: int) -> None:
    m = model(BODIES[name](), order)
    fast, slow = NativeInstance(m), PythonInstance(m)
    for i in range(30):
        u = np.sin(0.3 * i + np.arange(m.step.nu))
        for instance in (fast, slow):
            instance.set_input(u)
            instance.do_step(0.01 * i, 0.01)
        ledger = fast.ledger()
        assert abs(ledger["stored"] + ledger["dissipated"] - ledger["supplied"]).max() <= 2e-13
    assert fast.counts["schur"] == 30
    assert np.abs(fast.x - slow.x).max() <= 1e-11
    assert np.abs(fast.signal("a") - slow.signal("a")).max() <= 1e-9 * (1 + np.abs(slow.signal("a")).max())
    assert np.abs(fast.output() - slow.output()).max(initial=0.0) <= 1e-12


@pytest.mark.parametrize(("k24", "sweeps"), [(500.0, 8), (1e6, 8), (1e8, 9)])
def test_stiff_springs_cost_no_more_sweeps(k24: float, sweeps: int) -> None:
    declaration = four_particle().with_starts({"k24": k24})
    instance = NativeInstance(build_model(declaration, default_scheme(declaration, 6)))
    ledger = instance.run(0.0, 0.01, 100, ["stored", "dissipated"])
    assert instance.counts["schur"] == 100
    assert instance.counts["sweeps"] <= 100 * sweeps
    assert np.abs(ledger["stored"] + ledger["dissipated"]).max() <= 1e-13
    assert np.abs(instance.signals()["observables"]).max() <= 1e-14


@pytest.mark.parametrize("order", [2, pytest.param(6, marks=pytest.mark.slow)])
def test_restored_states_continue_bit_by_bit(order: int) -> None:
    m = model(chain(3), order)
    one, two = NativeInstance(m), NativeInstance(m)
    one.run(0.0, 0.02, 20)
    two.run(0.0, 0.05, 3)
    two.set_state(one.get_state())
    for instance in (one, two):
        instance.run(0.4, 0.03, 20)
    assert one.get_state() == two.get_state()


def test_positions_far_away_are_as_exact_as_near_the_origin() -> None:
    near, far = four_particle(), four_particle()
    q = np.array(near.states[0].start)
    far = far.with_starts({f"q[{i + 1}]": v + 1024.0 for i, v in enumerate(q)})
    runs = []
    for declaration in (near, far):
        instance = NativeInstance(build_model(declaration, default_scheme(declaration, 6)))
        instance.run(0.0, 0.01, 300)
        runs.append(instance.x[12:])
    assert np.abs(runs[0] - runs[1]).max() <= 1e-13


def led() -> Multibody:
    """A particle on a curve that is not quadratic."""
    body = Multibody("led")
    p = body.particle(1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    body.constraint(lambda at: at(p)[2] - at(p)[0] ** 3)
    return body


def test_other_forms_have_no_schur_stepper() -> None:
    declaration = four_particle()
    assert build_model(declaration, Collocated(1)).step.schur is None
    assert model(led(), 2).step.schur is None
    assert build_model(declaration, default_scheme(declaration, 2)).step.schur is not None


@pytest.mark.parametrize("k", [1, 3])
def test_matrices_of_the_nodes(k: int) -> None:
    m = model(chain(2), 2 * k).step.schur
    assert m is not None
    nd = nodes(k)
    bordered = np.block([[nd.a, -np.ones((k, 1))], [nd.b, np.zeros((1, 1))]])
    assert np.abs(m.multiplier.reshape(k + 1, k + 1) @ bordered - np.eye(k + 1)).max() <= 1e-13
    value, t, back = spectrum(k)
    block = np.diag(np.full(k, value[0]))
    if k == 3:
        block[1:, 1:] = [[value[1], -value[2]], [value[2], value[1]]]
    inverse = np.linalg.inv(nd.a)
    # modes combine the real and imaginary parts of one eigenvector: T M T^-1 on (real, re, im)
    assert np.abs(t @ block @ back - inverse @ inverse).max() <= 1e-10


@pytest.mark.parametrize(("m", "n", "listed"), [(9, 20, 9), (70, 90, 15)])
def test_symbolic_elimination_factors_a_schur_matrix(m: int, n: int, listed: int) -> None:
    """`listed`: at most so many columns of the many rows have lists of updates, the others are a block without gaps."""
    rng = np.random.default_rng(4)
    mass = rng.uniform(0.5, 2.0, n)
    rows, slots, d = [], [], np.zeros((m, n))
    for r in range(m):
        rows.append([])
        for dof in rng.choice(n, 4, replace=False):
            sign, value = rng.choice([-1.0, 1.0]), rng.uniform(0.5, 1.0)
            rows[r].append((int(dof), len(slots), sign))
            slots.append(value)
            d[r, dof] = sign * value
    e = eliminate(rows)
    terms = e.product_sign * np.array(slots)[e.product_a] * np.array(slots)[e.product_b] / mass[e.product_dof]
    entry = np.array([terms[a:b].sum() for a, b in zip(e.product_ptr, e.product_ptr[1:], strict=False)])
    lower, place = np.eye(m), {int(r): i for i, r in enumerate(e.order)}
    assert e.full <= listed and len(e.update_target) == e.update_ptr[e.full] == e.update_ptr[m]
    for j in range(m):
        for q in range(e.update_ptr[j], e.update_ptr[j + 1]):
            entry[e.update_target[q]] -= entry[e.update_left[q]] * entry[e.update_right[q]] / entry[j]
        for l in range(j + 1, m if j >= e.full else 0):
            left = e.column[j] - j - 1
            entry[l] -= entry[left + l] ** 2 / entry[j]
            for i in range(l + 1, m):
                entry[e.column[l] - l - 1 + i] -= entry[left + i] * entry[left + l] / entry[j]
        for q in range(e.column[j], e.column[j + 1]):
            entry[q] /= entry[j]
            lower[place[int(e.below[q - m])], j] = entry[q]
    whole = lower @ np.diag(entry[:m]) @ lower.T
    exact = (d / mass @ d.T)[np.ix_(e.order, e.order)]
    assert np.abs(whole - exact).max() <= 1e-12


@pytest.mark.parametrize(("name", "order"), [("chain", 2), slow(("stiff chain", 6)), slow(("pushed", 6))])
def test_written_out_loops_give_the_same_bits(
    name: str, order: int, optimised: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A small model, whose tables the compiler knows, against the same loops over the tables of the plan."""
    m, found, sources = model(BODIES[name](), order), [], []
    for most in (text.MOST, 0):
        monkeypatch.setattr(text, "MOST", most)
        sources.append(kernel_table(kernels(m), m.step.schur).text)
        instance = NativeInstance(m)
        for i in range(50):
            instance.set_input(np.sin(0.3 * i + np.arange(m.step.nu)))
            instance.do_step(0.01 * i, 0.01)
        assert instance.counts["schur"] == 50
        found.append((instance.x.tobytes(), instance.unknowns.tobytes(), instance.counts["sweeps"]))
    assert "small_tables" in sources[0] and "small_tables" not in sources[1]
    assert found[0] == found[1]


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 6])
def test_wider_vectors_give_the_same_bits(order: int, optimised: None) -> None:
    """The library for this machine's vectors against the portable one of an FMU."""
    if not host_flags():
        pytest.skip("this machine has no wider vectors")
    m = model(chain(3), order)
    table = kernel_table(kernels(m), m.step.schur)
    portable = load(compile({**runtime_sources(), "kernels.c": table.text}, flags=("-Wall", "-Wextra", "-Werror")).path)
    tables = CTables(m, table.index, ctypes.addressof(ctypes.c_char.in_dll(portable, "ph_the_code")))
    memory = np.zeros(portable.ph_size(tables.pointer) // 8 + 1)
    address = memory.ctypes.data
    assert portable.ph_init(address, tables.pointer) == 0 and portable.ph_initialise(address) == 0
    instance = NativeInstance(m)
    for i in range(50):
        assert portable.ph_step(address, i * 0.02, 0.02) == 0
        instance.do_step(i * 0.02, 0.02)
    saved = ctypes.create_string_buffer(portable.ph_state_size(address))
    portable.ph_save(address, saved)
    assert saved.raw == instance.get_state()


def tangle(n: int) -> Multibody:
    """A chain numbered at random with springs and dampers across, driven at its tip: tiles reach into each other."""
    rng = np.random.default_rng(7)
    place = rng.permutation(n)
    body = Multibody(f"tangle_{n}")
    body.gravity((0.0, 0.0, -9.81))
    where = rng.uniform(-0.2, 0.2, (n, 3)) + np.arange(1, n + 1)[:, None] * np.array([0.9, 0.3, 0.1])
    made = {int(i): body.particle(float(rng.uniform(0.5, 2.0)), tuple(where[i])) for i in place}
    points = [body.support((0.0, 0.0, 0.0)), *(made[i] for i in range(n))]
    for i, (a, b) in enumerate(zip(points, points[1:], strict=False)):
        if i % 5 == 4:
            body.linear_spring(a, b, 60.0, 1.0)
        else:
            body.bar(a, b)
        if i > 3:
            body.damper(points[i - 3], b, 0.3)
    body.port("tip", made[n - 1])
    return body


@pytest.mark.parametrize("order", [2, pytest.param(6, marks=pytest.mark.slow)])
def test_tiles_change_nothing_but_the_order_of_sums(order: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sweeps over small tiles find the solution of one over all, in as many sweeps; every instance is in one tile."""
    found = []
    for size in (7, 10**6):
        monkeypatch.setattr(lane_groups, "TILE", size)
        m = model(tangle(11), order)
        schur = m.step.schur
        assert schur is not None and len(schur.tile.dof) - 1 == -(-33 // size)
        assert all(g.until[-1] == g.n and (np.diff(g.until) >= 0).all() for g in schur.groups)
        instance = NativeInstance(m)
        instance.set_input([0.3, -0.2, 0.5])
        instance.run(0.0, 0.005, 20)
        assert instance.counts["schur"] == 20
        found.append((instance.x.copy(), instance.counts["sweeps"]))
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-11, abs=1e-11)
    assert abs(found[0][1] - found[1][1]) <= 1


def test_multipliers_are_continued() -> None:
    """A slider-crank that moves smoothly takes a sweep a step fewer than with the multipliers of the last step as they were.

    Those are off by h lambda', which costs a first sweep that moves velocities as far as the second moves them back: 5.7
    instead of 4.3 sweeps.
    """
    declaration = slider_crank()
    instance = NativeInstance(build_model(declaration, default_scheme(declaration, 6)), kernels="compiled")
    instance.run(0.0, 2.5e-3, 400)
    assert instance.counts["sweeps"] <= 5 * 400
