"""Kinks and jumps of energies: what the check says of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    NativeInstance,
    Problem,
    PythonInstance,
    build_model,
    check,
    energy,
    parameter,
    skew,
    state,
)
from phfmu.checks.energies import bounded, constants
from phfmu.checks.pieces import continuous, kinks
from phfmu.checks.sample import Sample
from phfmu.components.library import LIBRARY, build
from phfmu.declare.energy import Energy
from phfmu.declare.entries.entries import Entries, normal_form
from phfmu.fmu.export.export import export
from phfmu.fmu.importer.reader import FMUInstance
from tests.checks.kinked import (
    OPERATIONS,
    STOPS,
    applied,
    energies,
    instance,
    oscillator,
    run,
)

# -- check --------------------------------------------------------------------------------------------------------


def told(of: Callable[[ca.SX], ca.SX]) -> list[Problem]:
    return check(oscillator(of), strict=True)


@pytest.mark.parametrize(
    ("of", "text"),
    [
        (STOPS["stop"][0], r"kink \(fmax\), its gradient jumps at q = 1: steps over it limit the order to 2"),
        (STOPS["contact"][0], r"\(fmax\) that meet smoothly at q = 1: steps over it limit the order to 3"),
        (lambda q: ca.if_else(q > 0.5, q - 0.5, 0), r"\(if_else\), its gradient jumps at q = 0.5"),
        (lambda q: ca.fmax(q - 1e3, 0), r"pieces \(fmax\): steps from one to the next limit the order to 2 or 3"),
    ],
)
def test_a_kink_is_a_warning_with_its_operation_and_what_it_means(of, text):
    (found,) = told(of)
    assert (found.rule, found.severity, found.entry) == ("kink", "warning", "energy term 2")
    assert re.search(text, found.reason) and "balance is exact" in found.remedy
    assert check(oscillator(of)) == []


@pytest.mark.parametrize(
    ("of", "jump"),
    [
        (lambda q: 2 * ca.floor(q), "2 J at q = "),
        (lambda q: ca.sign(q - 0.3), "J at q = 0.3"),
        (lambda q: ca.if_else(q > 1, 20 * q, 0), "20 J at q = 1"),
    ],
)
def test_an_energy_that_jumps_is_a_problem(of, jump):
    (found,) = check(oscillator(of))
    assert found.rule == "energy" and jump in found.reason and "continuous" in found.remedy


def test_smooth_energies_and_continuous_uses_of_jumps_pass():
    assert told(lambda q: ca.sqrt(1 + q**2)) == []
    assert [p.rule for p in told(lambda q: (ca.fmod(q + 10, 1) - 0.5) ** 2)] == [
        "kink"
    ]  # a sawtooth squared has no jump


@pytest.mark.parametrize("gradient", ["per-term", "joint-gonzalez", "mean-value", "itoh-abe"])
def test_a_constant_term_is_left_out_and_told(gradient):
    """With and without it the steps are the same to the last bit."""
    (found,) = told(lambda q: ca.SX(1e9))
    assert found.severity == "warning" and "no state in it" in found.reason
    plain, shifted = (
        PythonInstance(build_model(oscillator(*e), Collocated(1, gradient))) for e in ((), (lambda q: ca.SX(1e9),))
    )
    (a, stored_a), (b, stored_b) = (run(u, (2.0, 0.0), 0.1, 5) for u in (plain, shifted))
    assert (a == b).all() and (stored_a == stored_b).all()


def test_a_quadratic_energy_without_a_lower_bound_is_told():
    """H = q1^2 + q2^2 - c q1 q2 is indefinite for c > 2: eigenvalue 2 - c along q1 = q2; a quartic may hold it back."""
    q, p = state("q", 2, start=[0.1, 0.2]), state("p", 2)
    c = parameter("c", 3.0)
    coupled = energy(ca.sumsqr(q.sx) - c * q[0] * q[1])

    def model(*more: Energy) -> PHDAE:
        energies = (energy(ca.sumsqr(p.sx) / 2), coupled, *more)
        return PHDAE("pair", states=(q, p), parameters=(c,), energies=energies, structure=(skew(q, p, 1.0),))

    (found,) = check(model(), strict=True)
    assert (found.rule, found.severity) == ("bounded", "warning")
    assert (
        "q[1] = 0.707, q[2] = 0.707" in found.reason and "eigenvalue -1 J" in found.reason and "c = 3" in found.reason
    )
    assert check(model().with_starts({"c": 1.9}), strict=True) == []
    assert check(model(energy(ca.sumsqr(q.sx) ** 2)), strict=True) == []


def test_the_library_has_no_such_warning():
    """But for the rubber of a box, whose force begins with a kink."""
    for name in (n for n in LIBRARY if n != "box_on_floor"):
        model = build(name)
        model = model if isinstance(model, PHDAE) else model.declaration()
        entries = Entries(model)
        normal_form(entries)
        sample = Sample(entries)
        assert [p for rule in (continuous, kinks, bounded, constants) for p in rule(entries, sample)] == []


@cache
def all_operations() -> PHDAE:
    """An energy with every operation in it; jumps are multiplied by what vanishes where they are."""

    def of(q: ca.SX) -> ca.SX:
        total = ca.SX(0)
        for i, name in enumerate(OPERATIONS):
            shifted = q * (0.5 + 0.01 * i) - 0.1
            total += 0.01 * ca.cos(i + 0.0) * applied(name, shifted, 0.3 * q + 0.7) * shifted**2
        return total

    return oscillator(of)


@pytest.mark.slow
def test_native_units_take_every_operation(compiler):
    """What is stored is the difference of H in generated C too."""
    model = all_operations()
    unit = NativeInstance(build_model(model))
    h = ca.Function("h", [model.x], [model.hamiltonian])
    states, stored = run(unit, (0.9, 0.3), 0.02, 20)
    values = np.array([float(h(x)) for x in states])
    assert np.cumsum(stored) == pytest.approx(values[1:] - values[0], abs=1e-12 * np.max(np.abs(values)))
    twin, _ = run(PythonInstance(build_model(model)), (0.9, 0.3), 0.02, 20)
    assert np.max(np.abs(states - twin)) <= 1e-10


def test_a_unit_keeps_its_energy_over_kinks(compiler, tmp_path):
    """The stop as FMI 3.0 unit: its states keep H, and so does the energy it reports."""
    model = instance("stop", "order 2", True).model
    (path,) = export(model, tmp_path, ("3.0",), step=0.05, stop=2.0)
    with FMUInstance(path) as unit:
        for i in range(40):
            unit.do_step(0.05 * i, 0.05)
            q, p, stored = unit.get(["q", "p", "energy.stored"])
            assert energies("stop", np.array([[q, p]]))[0] == pytest.approx(22.0, rel=1e-12)
            assert stored == pytest.approx(22.0, rel=1e-12)
