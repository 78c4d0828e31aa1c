"""Sensitivities over several internal steps, against differences of the step map, in both engines and in units."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Domain,
    FMUInstance,
    NativeInstance,
    Port,
    PythonInstance,
    Scene,
    Status,
    StepFailure,
    block,
    build_model,
    energy,
    export,
    state,
)
from phfmu.components.library import build
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.discretise.model import Model
from phfmu.engine.native.code import Functions
from phfmu.schemes.named import named_scheme
from tests.engines import ENGINES
from tests.wide import wide

PARTS = (1, 3, 10)
PULL = Domain("pull", "f", "N", "v", "m/s", "flow")
#: target, order, internal step, relative accuracy of the differences: rounding of energies as large as those of smib
CASES = {
    "dc_motor-2": ("dc_motor", 2, 1e-3, 1e-12),
    "dc_motor-4": ("dc_motor", 4, 1e-3, 1e-12),
    "four_particle-2": ("four_particle", 2, 5e-3, 1e-10),
    "smib-2": ("smib", 2, 1e-3, 1e-9),
    "smib-4": ("smib", 4, 1e-3, 1e-9),
}
SOME = wide(CASES, "dc_motor-4", "four_particle-2")


def pulled() -> PHDAE:
    """Four particles with two rigid bars, pulled at two of them."""
    d = four_particle()
    v = next(s for s in d.states if s.name == "v")
    ends = (
        Port("a", PULL, "effort", {v: np.eye(12)[:, 3:6]}, size=3),
        Port("b", PULL, "effort", {v: np.eye(12)[:, 6:9]}, size=3),
    )
    return replace(d, ports=ends)


@pytest.fixture(scope="module")
def models():
    made: dict[str, tuple[PHDAE, Model, float]] = {}

    def get(case: str) -> tuple[PHDAE, Model, float]:
        if case not in made:
            name, order, step, _ = CASES[case]
            found = pulled() if name == "four_particle" else build(name)
            declaration = found.declaration() if isinstance(found, Scene) else found
            made[case] = declaration, build_model(declaration, named_scheme(declaration, "auto", order)), step
        return made[case]

    return get


def inputs(declaration: PHDAE, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Inputs near the start and the size of their differences."""
    nominal = [np.broadcast_to(np.asarray(p.nominal, float), p.n) for p in declaration.ports if p.external]
    size = 0.2 * np.concatenate(nominal)
    return model.u0 + size * np.random.default_rng(0).normal(size=len(size)), size


def differences(outputs, u: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Central differences, twice extrapolated: the error is of order 6 in `size`."""
    columns = []
    for j, e in enumerate(np.diag(size)):
        a, b, c = ((outputs(u + s * e) - outputs(u - s * e)) / (2 * s * size[j]) for s in (1.0, 0.5, 0.25))
        ab, bc = (4 * b - a) / 3, (4 * c - b) / 3
        columns.append((16 * bc - ab) / 15)
    return np.column_stack(columns)


def agree(S: np.ndarray, expected: np.ndarray, accuracy: float) -> None:
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(S, expected, rtol=0, atol=accuracy * np.abs(expected).max())


def follows(
    instance, declaration: PHDAE, model: Model, step: float, accuracy: float, parts: int, do_step
) -> np.ndarray:
    """The sensitivity of the fourth communication step, equal to differences of it; it is the last step at the end."""
    u, size = inputs(declaration, model)
    instance.reset()
    instance.set_input(u)
    h = step * parts
    for k in range(3):
        do_step(k * h, h)
    state = instance.get_state()

    def outputs(value: np.ndarray) -> np.ndarray:
        instance.set_state(state)
        instance.set_input(value)
        do_step(3 * h, h)
        return np.array(instance.output())

    outputs(u)
    S = instance.sensitivity()
    agree(S, differences(outputs, u, size), accuracy)
    outputs(u)
    return S


@pytest.mark.parametrize("case", wide(CASES, "dc_motor-2", "dc_motor-4"))
def test_the_python_engine_chains_internal_steps(models, case: str) -> None:
    declaration, model, step = models(case)
    one = PythonInstance(model)
    for parts in PARTS[1:]:
        follows(one, declaration, model, step, CASES[case][3], parts, lambda t, h, n=parts: one.do_step(t, h, n))


@pytest.mark.parametrize("case", SOME)
def test_the_native_engine_does_the_same(models, case: str) -> None:
    declaration, model, step = models(case)
    native, python = NativeInstance(model), PythonInstance(model)
    accuracy = CASES[case][3]
    for parts in PARTS:
        found = [
            follows(i, declaration, model, step, accuracy, parts, lambda t, h, i=i, n=parts: i.do_step(t, h, n))
            for i in (native, python)
        ]
        agree(found[0], found[1], 1e-11)


@pytest.fixture(scope="module")
def units(models, tmp_path_factory: pytest.TempPathFactory):
    made: dict[str, dict[str, Path]] = {}

    def get(case: str) -> dict[str, Path]:
        if case not in made:
            declaration, model, step = models(case)
            paths = export(model, tmp_path_factory.mktemp(case), step=step)
            made[case] = dict(zip(("2.0", "3.0"), paths, strict=True))
        return made[case]

    return get


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("case", SOME)
def test_units_do_the_same_forward_and_adjoint(models, units, case: str, version: str) -> None:
    declaration, model, step = models(case)
    with FMUInstance(units(case)[version]) as unit:
        for parts in PARTS:
            S = follows(unit, declaration, model, step, CASES[case][3], parts, unit.do_step)
            if version == "2.0":
                continue
            references = [[unit.variable(n).reference for n in names] for names in (unit.inputs, _means(unit))]
            seed = np.random.default_rng(parts).normal(size=len(S))
            forward = unit._slave.fmu.getDirectionalDerivative(references[1], references[0], seed.tolist())
            adjoint = unit._slave.fmu.getAdjointDerivative(references[1], references[0], seed.tolist())
            agree(np.array(forward), S @ seed, 1e-14)
            agree(np.array(adjoint), S.T @ seed, 1e-14)


def _means(unit: FMUInstance) -> list[str]:
    return [n for p in unit.ports for n in p.step_outputs]


@pytest.mark.parametrize("engine", ENGINES)
def test_asking_changes_nothing_and_belongs_to_the_saved_state(models, engine: type) -> None:
    declaration, model, step = models("four_particle-2")
    u, _ = inputs(declaration, model)
    asked, silent = engine(model), engine(model)
    for one in (asked, silent):
        one.set_input(u)
        for k in range(4):
            one.do_step(3 * k * step, 3 * step, 3)
            if one is asked:
                S = one.sensitivity()
    state = asked.get_state()
    assert asked.counts == silent.counts
    for one in (asked, silent):
        one.do_step(12 * step, step)
    assert asked.x.tobytes() == silent.x.tobytes()
    asked.set_state(state)
    asked.set_input(7.0 * u)
    np.testing.assert_array_equal(asked.sensitivity(), S, "inputs set since then are of the next step")


@pytest.mark.parametrize("engine", ENGINES)
def test_with_inputs_at_nodes_it_is_with_respect_to_all_of_them_together(models, engine: type) -> None:
    declaration, model, step = models("dc_motor-4")
    one, parts = engine(model), 3
    u, size = inputs(declaration, model)
    tilt = np.outer([-1.0, 2.0], size)
    start = one.get_state()

    def outputs(value: np.ndarray) -> np.ndarray:
        one.set_state(start)
        one.set_node_inputs(value + tilt)
        one.do_step(0.0, parts * step, parts)
        return one.output()

    outputs(u)
    agree(one.sensitivity(), differences(outputs, u, size), 1e-12)


def test_tangents_are_made_when_they_are_asked_for(models, monkeypatch: pytest.MonkeyPatch) -> None:
    from phfmu.engine.native import derivatives

    made: list[object] = []
    monkeypatch.setattr(derivatives, "Functions", lambda *a: made.append(a) or Functions(*a))
    declaration, model, step = models("dc_motor-2")
    one = NativeInstance(model)
    one.do_step(0.0, step)
    one.sensitivity()
    one.do_step(step, 3 * step, 3)
    assert not made
    one.sensitivity()
    one.sensitivity()
    assert len(made) == 1


@pytest.mark.parametrize("engine", ENGINES)
def test_before_the_first_step_there_is_none(models, engine: type) -> None:
    one = engine(models("dc_motor-2")[1])
    with pytest.raises(StepFailure) as failure:
        one.sensitivity()
    assert failure.value.status is Status.NO_SENSITIVITY


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_units_have_derivatives_of_steps_that_were_halved(tmp_path: Path, version: str) -> None:
    """x' = x^2 + u from 1: of two internal steps of 0.4 s the second is halved."""
    x = state("x", start=1.0)
    push = Port("push", PULL, "effort", {x: 1.0})
    d = PHDAE("grows", (x,), energies=(energy(0.5 * x.sx**2),), dissipation=(block((x,), -x.sx),), ports=(push,))
    native = NativeInstance(build_model(d))
    (path,) = export(native.model, tmp_path, (version,), step=0.4)
    native.do_step(0.0, 0.8, 2)
    assert native.counts["substeps"] > 0
    with FMUInstance(path) as unit:
        unit.do_step(0.0, 0.8)
        np.testing.assert_allclose(unit.sensitivity(), native.sensitivity(), rtol=1e-12)
