"""Declarations that are alike share plans and compiled code, and nothing else."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    Holonomic,
    NativeInstance,
    Port,
    algebraic,
    build_model,
    damping,
    energy,
    parameter,
    skew,
    state,
)
from phfmu.components.library import build
from phfmu.components.mechanical.translational import mass, spring
from phfmu.declare.entries.alike import first_alike, form
from phfmu.engine.native.native_model import native_model


def coil(law=lambda x, a: a * x**2, unit="V.s", r=2.0, turns=1.0) -> PHDAE:
    flux, a, ohm = state("flux", unit=unit), parameter("a", 3.0, unit="1/H"), parameter("r", r, unit="ohm")
    return PHDAE(
        "coil", states=(flux,), parameters=(a, ohm), energies=(energy(law(flux.sx, a.sx)),),
        dissipation=(damping(flux, ohm),), ports=(Port("terminal", ELECTRICAL, "effort", {flux: turns}),),
    )  # fmt: skip


def test_only_start_values_and_words_may_differ() -> None:
    given = coil()
    assert form(coil(r=5.0)) == form(replace(given, name="other", description="x")) == form(given)
    assert form(given.with_starts({"flux": 3.0, "a": 1.0, "terminal.v": 2.0})) == form(given)
    others = [coil(lambda x, a: a * x**4), coil(unit="Wb"), coil(turns=2.0), coil(lambda x, a: 2.0 * a * x**2),
              replace(given, ports=()), replace(given, dissipation=()),
              coil(lambda x, a: a * x**2 + 0 * ca.sin(a))]  # fmt: skip
    assert form(given) not in [form(o) for o in others[:-1]]
    swapped = coil(lambda x, a: x * a**2)  # the same operations on other symbols
    assert form(swapped) != form(given)


@pytest.mark.parametrize(
    "name", ["synchronous_machine", "rl_line", "infinite_bus", "fault_resistor", "spring", "thyristor"]
)
def test_components_made_twice_are_alike(name: str) -> None:
    one, two = build(name), build(name)
    assert first_alike(two) is first_alike(one)


def test_alike_components_share_plans_and_code_not_values() -> None:
    one, two = build_model(mass(1.0, k=4.0)), build_model(replace(mass(2.0, k=9.0, q=1.0, v=3.0), name="second"))
    assert two.step is one.step and two.instant is one.instant
    assert two.name == "second" and two.declaration.name == "second"
    assert list(two.x0) == [1.0, 3.0] and list(two.p0) == [2.0, 9.0] and list(one.x0) == [0.0, 0.0]
    first = one.first or one  # that of another test, if it is still held
    assert two.first is first
    own, shared = native_model(two), native_model(first)
    assert own.code is shared.code and own.tables.size < shared.tables.size / 4
    a, b = NativeInstance(one), NativeInstance(two)
    h = 0.1
    for unit in (a, b):
        unit.set_input([1.0])
        unit.do_step(0.0, h)
    for unit, m, k, q, v in ((a, 1.0, 4.0, 0.0, 0.0), (b, 2.0, 9.0, 1.0, 3.0)):
        # midpoint rule by hand: m dv = h (1 - k (q + dq/2)), dq = h (v + dv/2)
        dv = h * (1.0 - k * (q + h * v / 2)) / (m + k * h**2 / 4)
        assert unit.x == pytest.approx([q + h * (v + dv / 2), v + dv], rel=1e-14)
    b.reset()
    assert list(b.x) == [1.0, 3.0]


def test_other_schemes_and_equations_have_plans_of_their_own() -> None:
    one = build_model(mass(1.0))
    assert build_model(mass(1.0), Collocated(2)).step is not one.step
    assert build_model(mass(1.0, d=1.0)).step is not one.step
    assert build_model(spring(1.0)).step is not one.step


def test_where_starts_decide_of_the_plan_only_equal_starts_share_it() -> None:
    """Of redundant constraints some rest at the start; which ones depends on it."""
    q, v, lam = state("q", 2, start=(3.0, 4.0)), state("v", 2, start=(-4.0, 3.0)), algebraic("lam")
    length = Holonomic(lam, ca.sumsqr(q.sx) / 50.0 - 0.5)
    bob = PHDAE("bob", states=(q, v), algebraics=(lam,), energies=(energy(ca.sumsqr(v.sx) / 2),),
                structure=(skew(q, v, 1.0),), constraints=(length,))  # fmt: skip
    here, there = bob.with_starts({"q[1]": 3.0}), bob.with_starts({"q[1]": -3.0, "v[2]": -3.0})
    assert first_alike(here) is first_alike(there) is first_alike(bob)
    model = build_model(bob)
    assert build_model(here).step is model.step
    assert build_model(there).step is not model.step


def test_switches_and_mistakes_are_as_before() -> None:
    assert build_model(build("diode")).modes is not None
    with pytest.raises(ValueError, match="start"):
        build_model(mass(1.0, v=np.nan))


def test_a_plan_changed_by_hand_is_compiled_for_itself() -> None:
    """Without its Schur stepper a model takes Newton's method, though one that is alike was compiled with it before."""
    one, two = build_model(build("chain")), build_model(build("chain"))
    changed = replace(two, step=replace(two.step, schur=None))
    assert two.first is one and native_model(two).code is native_model(one).code
    with_it, without = NativeInstance(two), NativeInstance(changed)
    with_it.do_step(0.0, 0.01)
    without.do_step(0.0, 0.01)
    assert (with_it.counts["schur"], without.counts["schur"]) == (1, 0)
