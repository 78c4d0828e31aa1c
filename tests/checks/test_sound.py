"""Sound models pass the check, and random ones; what is wrong with a random one is found."""

import importlib
import inspect
import pkgutil
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import phfmu.components
from phfmu import (
    ELECTRICAL,
    PHDAE,
    Network,
    Port,
    block,
    check,
    energy,
    observable,
    state,
    time,
)
from phfmu.components.library import SWITCHED
from phfmu.components.mechanical.translational import mass, spring
from tests.checks.models import holonomic, oscillator, resistive, rules, source, two_lines

# -- sound models ---

#: arguments of library functions whose required arguments are not just numbers, or that need at least one
ARGUMENTS = {
    "load": ({"P": 1.0, "V": 1.0},),
    "grid_scene": (),  # of a table of a grid: components/test_grids.py
    "capacitor_network": ({"C": [[2e-6, -1e-6], [-1e-6, 3e-6]]},),
    "shunt": ({"Q": 1.0, "V": 1.0},),
    "capacitor_bank": ({"Q": 1.0, "V": 1.0},),
    "constant_power_load": ({"P": 1.0, "V": 1.0},),
    "grid_following_inverter": ({"P": 1.0, "V": 1.0, "S": 2.0},),
    "saturating_reactor": ({"points": ((1.0, 0.1), (1.2, 1.0))},),
    "rlc_load": ({"R": 2.0}, {"L": 0.1}, {"C": 1e-3}, {"R": 2.0, "L": 0.1, "C": 1e-3}),
    "synchronous_machine": tuple({"coordinates": c} for c in ("dq-flux", "abc-flux", "current")),
    "mass": ({}, {"k": 2.0, "d": 0.1}), "spring": ({}, {"d": 0.1})}  # fmt: skip


def library() -> list[tuple[str, Any]]:
    """Every public function of phfmu.components that returns a model or a scene, with arguments."""
    found = []
    for info in pkgutil.walk_packages(phfmu.components.__path__, "phfmu.components."):
        if info.ispkg:
            continue
        module = importlib.import_module(info.name)
        for name, function in inspect.getmembers(module, inspect.isfunction):
            signature = inspect.signature(function)
            own = function.__module__ == info.name and not name.startswith("_")
            if not own or signature.return_annotation not in ("PHDAE", "Scene"):
                continue
            needed = [p for p in signature.parameters.values() if p.default is p.empty and p.kind < p.VAR_POSITIONAL]
            for kwargs in ARGUMENTS.get(name, ({},)):
                given = {p.name: 1.0 for p in needed if p.name not in kwargs} | kwargs
                label = ", ".join(f"{k}={v}" for k, v in given.items())
                # what is switched is checked with its warnings in components/test_converters.py
                long = pytest.mark.slow if name in ("chain", "fekete", "ladder", "net", *SWITCHED) else ()
                found.append(pytest.param(function, given, id=f"{name}({label})", marks=long))
    return found


@pytest.mark.parametrize(("function", "arguments"), library())
def test_the_library_is_sound(function, arguments):
    model = function(**arguments)
    declaration = model if isinstance(model, PHDAE) else model.declaration()
    assert list(map(str, check(declaration))) == []


def test_sound_models_of_this_file():
    for model in (oscillator(), resistive()[2], holonomic(("unit",)), two_lines(1.0), source(lambda i: time)):
        assert list(map(str, check(model))) == []


def test_a_composed_network_is_sound():
    net = Network("pair")
    net.add("one", mass(1.0, k=3.0, d=0.2, q=0.1))
    net.add("two", spring(2.0, d=0.3))
    net.connect("one.flange", "two.a")
    assert list(map(str, check(net.compose()))) == []


# -- random models ---


@st.composite
def random_models(draw):
    """Random skew J, psd R (rank 1 to n), regular E, quadratic H, B; returns the model and its parts."""
    n = draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    x = state("x", n, start=rng.uniform(-1, 1, n), nominal=10.0 ** rng.integers(-3, 4, n))
    a, low = rng.standard_normal((n, n)), rng.standard_normal((n, draw(st.integers(1, n))))
    e, h = rng.standard_normal((n, n)) + 4 * n**0.5 * np.eye(n), rng.standard_normal((n, n))
    J = ca.SX(a - a.T) * (1 + x[0] ** 2)
    hamiltonian = 0.5 * ca.bilin(ca.SX(h + h.T), x.sx, x.sx)
    port = Port("pin", ELECTRICAL, "effort", {x: ca.SX(rng.standard_normal((n, 2)))}, size=2)
    model = PHDAE(
        "random", states=(x,), energies=(energy(hamiltonian),), E={x: e}, structure=(block([x], J),),
        dissipation=(block([x], low @ low.T),), ports=(port,),
        z={x: ca.solve(ca.SX(e.T), ca.SX(h + h.T) @ x.sx)},
    )  # fmt: skip
    return model, rng, low @ low.T


@settings(max_examples=10, deadline=None)
@given(random_models())
def test_random_models_are_sound(drawn):
    model, _, _ = drawn
    assert list(map(str, check(model))) == []


@settings(max_examples=10, deadline=None)
@given(random_models(), st.floats(1e-4, 10.0), st.sampled_from(["skew", "symmetry", "passivity", "costate"]))
def test_random_perturbations_are_caught(drawn, size, rule):
    model, rng, R = drawn
    x, n = model.states[0], model.states[0].n
    i, j = int(rng.integers(n)), int(rng.integers(n))
    bump = np.zeros((n, n))
    bump[i, j] = size * max(1.0, np.abs(R).max())
    if rule == "skew":
        model = replace(model, structure=(block([x], model.structure[0].matrix + bump),))
    elif rule == "symmetry":
        if i == j:
            return
        model = replace(model, dissipation=(block([x], R + bump),))
        assert rule in rules(model)  # the symmetric part may have become indefinite too
        return
    elif rule == "passivity":
        lowest = np.linalg.eigh(R)[1][:, :1]
        shift = (np.linalg.eigvalsh(R)[0] + bump[i, j]) * lowest @ lowest.T
        model = replace(model, dissipation=(block([x], R - shift),))
    else:
        z = ca.SX(model.z[x])
        z[i] += size * x[j] * max(1.0, 1e3)
        model = replace(model, z={x: z})
    assert rules(model) == [rule]


def test_a_name_with_a_quote_is_told_once_for_each_rule():
    """What a signal belongs to is asked of the declaration, not of the words about it."""
    x = state("a", start=1.0)
    twice = tuple(observable("x'a", x) for _ in range(2))
    found = check(PHDAE("m", states=(x,), energies=(energy(x**2 / 2),), observables=twice))
    assert [p.reason.rpartition("' ")[2] for p in found] == ["is not a structured name"] * 2 + ["is used 2 times"]
