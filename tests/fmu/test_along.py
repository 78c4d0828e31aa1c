"""Derivatives that units tell by states and parameters: differences of steps from other starts, both ways, what is refused."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phfmu import FMUInstance, build_model, default_scheme, export
from phfmu.components.library import build
from phfmu.declare.phdae import PHDAE
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.archive import open_archive
from tests.derivatives.differences import richardson
from tests.fmu import exported
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")

#: a communication step of so many internal ones
PARTS = 3
MODELS: dict[str, Callable[[], PHDAE]] = {
    "dc_motor": lambda: build("dc_motor"),
    "pendulum": exported.pendulum,
    "machine": lambda: build("smib").system.separate(set())["gen"],  # type: ignore[union-attr]
}
STEP = {"pendulum": 5e-3}
ORDERS = {"pendulum": (2, 6)}
CASES = [(n, order, version) for n in MODELS for order in ORDERS.get(n, (2, 4, 6)) for version in ("2.0", "3.0")]


def unit_file(folder: Path, name: str, order: int, version: str, **how: object) -> Path:
    d = replace(MODELS[name](), name=name)
    model = build_model(d, default_scheme(d, order))
    (path,) = export(model, folder, (version,), step=STEP.get(name, 1e-3), **{"node_inputs": order > 2} | how)  # type: ignore[arg-type]
    return path


def adjoint(unit: FMUInstance, unknowns: Sequence[str], knowns: Sequence[str], seed: np.ndarray) -> np.ndarray:
    """seed^T d unknowns / d knowns."""
    rows, columns = ((ctypes.c_uint * len(ns))(*(unit.variable(n).reference for n in ns)) for ns in (unknowns, knowns))
    weights, found = (ctypes.c_double * len(seed))(*seed), (ctypes.c_double * len(knowns))()
    arguments = rows, len(rows), columns, len(columns), weights, len(seed), found, len(found)
    unit._slave.call_plain("fmi3GetAdjointDerivative", arguments)  # type: ignore[attr-defined]
    return np.array(found)


class Stepped:
    """Values after a step from start values: states, values of the step, values now."""

    def __init__(self, path: Path):
        self.path, face = path, open_archive(path).interface
        self.h = PARTS * float(face.step or 0.0)
        self.states, self.of_step, self.now = (list(face.derived[n]) for n in ("states", "ofStep", "now"))
        self.parameters = [n for n, v in face.variables.items() if v.causality == "parameter"]
        self.start = {n: face.variables[n].start or 0.0 for n in (*self.states, *self.parameters)}

    def step(self, unit: FMUInstance, more: float = 0.0, which: int = 0) -> None:
        unit.set_input(unit.start_inputs() + 0.1 * (1.0 + np.arange(unit.nu)) + more * (np.arange(unit.nu) == which))
        unit.do_step(0.0, self.h)

    def values(self, starts: dict[str, float], more: float = 0.0, which: int = 0) -> np.ndarray:
        with FMUInstance(self.path, starts=starts) as unit:
            self.step(unit, more, which)
            return unit.get([*self.states, *self.of_step, *self.now])


@pytest.mark.parametrize(("name", "order", "version"), wide(CASES, ("dc_motor", 4, "3.0"), ("pendulum", 6, "2.0")))
def test_they_are_differences_of_steps(name: str, order: int, version: str, tmp_path: Path) -> None:
    """Of what follows the step, and of values now, which follow its end: their derivatives by states there chain.

    Differences of values of size V over a step e know slopes to about eps V / e, which is 1e-13 V of the largest here.
    """
    own = Stepped(unit_file(tmp_path, name, order, version))
    knowns = [n for n in (*own.states, *own.parameters) if name != "pendulum" or n not in own.states]
    knowns = knowns if len(knowns) < 9 else [*knowns[:2], "theta", "J", "Ra", "Ld", "M_f"]
    with FMUInstance(own.path) as unit:
        own.step(unit)
        moved = unit.derivatives([*own.states, *own.of_step], [*knowns, *unit.inputs])
        now = unit.derivatives(own.now, [*own.states, *knowns, *unit.inputs])
        inputs = list(unit.inputs)
    nx = len(own.states)
    at_once = now[:, nx:].copy()
    at_once[:, [i for i, n in enumerate(knowns) if n in own.states]] = 0.0  # those now, which are in the chain
    found = np.vstack([moved, now[:, :nx] @ moved[:nx] + at_once])
    size = np.abs(own.values({}))
    for j, n in enumerate([*knowns, *inputs]):
        base = own.start.get(n, 1.0)
        e = 1e-3 * (abs(base) if abs(base) > 1e-9 else 1.0)

        def values(v: float, n: str = n) -> np.ndarray:
            return own.values({n: v}) if n in own.start else own.values({}, v, inputs.index(n))

        slopes = richardson(values, own.start.get(n, 0.0), e)
        noise = 1e-12 * np.maximum(size, size.max() * 1e-3) / e
        assert np.all(np.abs(found[:, j] - slopes) <= 1e-7 * np.abs(slopes).max() + noise), n
        assert np.abs(slopes).max() > 0 or n == "L0"


@pytest.mark.parametrize("order", [2, *wide([4])])
def test_the_adjoint_is_the_transposed(order: int, tmp_path: Path) -> None:
    own = Stepped(unit_file(tmp_path, "dc_motor", order, "3.0"))
    unknowns, knowns = [*own.states, *own.of_step, *own.now], [*own.states, *own.parameters]
    with FMUInstance(own.path) as unit:
        own.step(unit)
        J = unit.derivatives(unknowns, [*knowns, *unit.inputs])
        rows = [adjoint(unit, unknowns, [*knowns, *unit.inputs], seed) for seed in np.eye(len(unknowns))]
        np.testing.assert_array_equal(np.array(rows), J)
        seed = np.linspace(-1.0, 2.0, len(unknowns))
        assert adjoint(unit, unknowns, knowns, seed) == pytest.approx(seed @ J[:, : len(knowns)], rel=1e-13)


def test_they_belong_to_the_step_that_is_restored(tmp_path: Path) -> None:
    own = Stepped(unit_file(tmp_path, "pendulum", 2, "3.0"))
    unknowns, knowns = [*own.states, *own.of_step, *own.now], [*own.states, *own.parameters]
    with FMUInstance(own.path) as unit:
        own.step(unit)
        state, first = unit.get_state(), unit.derivatives(unknowns, knowns)
        unit.set_input(np.array([3.0, -1.0]))
        unit.do_step(own.h, own.h)
        other = unit.derivatives(unknowns, knowns)
        assert np.abs(other - first).max() > 1e-3
        unit.set_state(state)
        np.testing.assert_array_equal(unit.derivatives(unknowns, knowns), first)
        # and asking has changed nothing that a later step depends on
        unit.set_input(np.array([3.0, -1.0]))
        unit.do_step(own.h, own.h)
        np.testing.assert_array_equal(unit.derivatives(unknowns, knowns), other)


@pytest.mark.parametrize("order", [2, *wide([4, 6])])
def test_impulses_at_the_ends_of_a_step_are_followed(order: int, tmp_path: Path) -> None:
    """A machine whose shaft and windings are pushed: by states and parameters, which turn the way that impulses act on, by
    impulses, and how their jump S follows."""
    path = unit_file(tmp_path, "machine", order, "3.0", impulses=True)
    own = Stepped(path)
    push = np.array([[0.3, -0.2, 0.1, 0.4, 2.0], [0.1, 0.2, -0.4, 0.3, -1.0]])

    def stepped(starts: dict[str, float], more: tuple[int, int, float] = (0, 0, 0.0)) -> FMUInstance:
        unit, s = FMUInstance(path, starts=starts), push.copy()
        s[more[0], more[1]] += more[2]
        unit.at_nodes.set_impulses(*s)
        own.step(unit)
        return unit

    rows, nx = [*own.states, *own.of_step], len(own.states)
    knowns = ["psi[1]", "theta", "J", "Ld", "M_f"]
    with stepped({}) as unit:
        impulses = [[names[side] for p in unit.ports for names in p.impulses] for side in (0, 1)]
        moved, by = unit.derivatives(rows, knowns), unit.derivatives(rows, [impulses[0][2], impulses[1][0]])
        now = unit.derivatives(own.now, [*own.states, *knowns])
    assert any(n.startswith("impulse.jump") for n in own.now)

    def values(starts: dict[str, float], more: tuple[int, int, float] = (0, 0, 0.0)) -> np.ndarray:
        with stepped(starts, more) as unit:
            return unit.get([*rows, *own.now])

    for j, n in enumerate(knowns):
        slopes = richardson(lambda v, n=n: values({n: v}), own.start[n], 1e-3 * abs(own.start[n]))
        at_once = 0.0 if n in own.states else now[:, nx + j]
        found = np.concatenate([moved[:, j], now[:, :nx] @ moved[:nx, j] + at_once])
        assert np.abs(found - slopes).max() <= 1e-8 * np.abs(slopes).max(), n
    for j, (side, i) in enumerate(((0, 2), (1, 0))):
        slopes = richardson(lambda v, s=side, i=i: values({}, (s, i, v)), 0.0, 1e-2)[: len(rows)]
        assert by[:, j] == pytest.approx(slopes, abs=float(1e-8 * np.abs(slopes).max()))


@pytest.mark.parametrize("version", ["3.0", *wide(["2.0"])])
def test_without_a_step_there_is_none_to_derive(version: str, tmp_path: Path) -> None:
    own = Stepped(unit_file(tmp_path, "dc_motor", 2, version))
    with FMUInstance(own.path) as unit:
        for begin in (lambda: None, unit.reset):
            begin()
            for unknown, known in (("w", "flux"), ("w", "J"), ("shaft.speed_step", "k"), ("w", "terminal.v")):
                with pytest.raises(FMUError, match="no step was taken since the start"):
                    unit.derivatives([unknown], [known])
            # values now have derivatives by what is there now, and outputs by inputs as ever
            assert unit.derivatives(["i"], ["flux"]) == pytest.approx(1.0 / own.start["L"])
            assert unit.derivatives(["terminal.i"], ["terminal.v"]).tolist() == [[0.0]]
            own.step(unit)
            assert unit.derivatives(["w"], ["w"])[0, 0] == pytest.approx(1.0, rel=0.1)


def test_what_has_none_is_refused_by_name(tmp_path: Path) -> None:
    path = unit_file(tmp_path, "dc_motor", 2, "3.0", tunable=["R"])
    own = Stepped(path)
    with FMUInstance(path) as unit:
        own.step(unit)
        for unknown, known, said in (
            ("energy.stored", "w", "'energy.stored' has no derivative"),
            ("w", "energy.stored", "'energy.stored' is no state, parameter or input"),
        ):
            with pytest.raises(FMUError, match=said):
                unit.derivatives([unknown], [known])
        unit.set({"R": 2.0})
        with pytest.raises(FMUError, match="parameters changed in the last step or after it"):
            unit.derivatives(["w"], ["R"])
        unit.do_step(own.h, own.h)
        assert unit.derivatives(["w"], ["R"])[0, 0] != 0.0
