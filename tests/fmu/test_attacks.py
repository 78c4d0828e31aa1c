"""Units of this package under rude hosts: calls in every mode, states of other instances, a thousand instances, odd steps."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import StepFailure, build_model, export
from phfmu.components.mechanical.translational import mass
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.schemes.collocated import Collocated
from tests.wide import slow

pytestmark = pytest.mark.usefixtures("compiler")

VERSIONS = ["2.0", "3.0"]
H, K, M = 0.1, 4.0, 1.3
NAMES = ["q", "v", "flange.velocity", "energy.stored", "energy.supplied", "energy.residual"]


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    declaration = mass(M, k=K, d=0.2, q=0.4)
    paths = export(
        build_model(declaration, Collocated(2)),
        tmp_path_factory.mktemp("units"),
        VERSIONS,
        step=H,
        stop=2.0,
        node_inputs=True,
    )
    return dict(zip(VERSIONS, paths, strict=True))


def bits(unit: FMUInstance) -> bytes:
    return unit.get(NAMES).tobytes()


def go_on(unit: FMUInstance, force: float = 0.3, first: int = 0, n: int = 5) -> bytes:
    for k in range(first, first + n):
        unit.set_input([force])
        unit.do_step(k * H, H)
    return bits(unit)


# -- calls in every mode -----------------------------------------------------------------------------------------------

#: call -> the modes in which the standard allows it (initialization: after `enter`; step: after `leave`)
ALLOWED = {
    "get": {"initialization", "step", "terminated"},
    "set input": {"instantiated", "initialization", "step"},
    "set start": {"instantiated", "initialization"},
    "set fixed": {"instantiated", "initialization"},
    "step": {"step"},
    "leave": {"initialization"},
    "terminate": {"step"},
    "save": {"instantiated", "initialization", "step", "terminated"},
    "derivative of a step": {"initialization"},  # of the values at the start; later there is no step yet
    "reset": {"instantiated", "initialization", "step", "terminated"},
}


def set_one(unit: FMUInstance, name: str, value: float) -> None:
    r = unit._slave.references([unit.variable(name)])
    r.values[:] = value
    unit._slave.set(r)


CALLS: dict[str, Callable[[Any], Any]] = {
    "get": lambda u: u._slave.get(u._slave.references([u.variable("q")])),
    "set input": lambda u: set_one(u, "flange.force", 0.7),
    "set start": lambda u: set_one(u, "q", 0.5),
    "set fixed": lambda u: set_one(u, "m", 2.0),
    "step": lambda u: u._slave.do_step(0.0, H, True),
    "leave": lambda u: u._slave.leave(),
    "terminate": lambda u: u._slave.call(u._slave.fmu.terminate),
    "save": lambda u: u._slave.forget(u._slave.save()),
    "derivative of a step": lambda u: u._slave.derivative(u._derivatives[0]),
    "reset": lambda u: u._slave.reset(),
}


def brought(unit: Any, mode: str) -> None:
    unit._slave.reset()
    if mode != "instantiated":
        unit._slave.enter(0.0, None, None)
    if mode in ("step", "terminated"):
        unit._slave.leave()
    if mode == "terminated":
        unit._slave.call(unit._slave.fmu.terminate)


@pytest.mark.parametrize("version", VERSIONS)
def test_every_call_in_every_mode(units: dict[str, Path], version: str) -> None:
    """What the standard allows is done; what it does not is refused in words, and the unit can be reset and used."""
    with FMUInstance(units[version]) as unit:
        untouched = go_on(unit)
        for mode in ("instantiated", "initialization", "step", "terminated"):
            for name, call in CALLS.items():
                brought(unit, mode)
                if mode in ALLOWED[name]:
                    call(unit)
                elif (version, name, mode) != ("2.0", "get", "instantiated"):
                    with pytest.raises(FMUError, match=r"mode|fixed|initialization|needs a last step"):
                        call(unit)
                unit.reset()
                assert go_on(unit) == untouched, (mode, name)


@pytest.mark.parametrize("version", VERSIONS)
def test_inputs_set_in_any_mode_are_those_of_the_first_step(units: dict[str, Path], version: str) -> None:
    with FMUInstance(units[version]) as unit:
        found = set()
        for mode in ("instantiated", "initialization", "step"):
            brought(unit, mode)
            set_one(unit, "flange.force", 0.7)
            if mode == "instantiated":
                unit._slave.enter(0.0, None, None)
            if mode != "step":
                unit._slave.leave()
            unit._slave.do_step(0.0, H, True)
            found.add(bits(unit))
        assert len(found) == 1
        unit.reset()
        assert go_on(unit, 0.7, n=1) in found and go_on(unit, 0.1, first=1, n=1) not in found


# -- instances and their states -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_may_be_restored_and_freed_by_another_instance(units: dict[str, Path], version: str) -> None:
    """It is one block without pointers: the other goes on with the same bits, the first is not touched."""
    with FMUInstance(units[version]) as one, FMUInstance(units[version]) as other:
        go_on(one, n=3)
        handle = one._slave.save()
        after = go_on(one, first=3)
        go_on(other, force=-5.0, n=7)
        other._slave.restore(handle)
        assert go_on(other, first=3) == after
        other._slave.forget(handle)
        assert bits(one) == after
        assert go_on(one, first=8) == go_on(other, first=8)


@pytest.mark.parametrize("version", VERSIONS)
def test_states_outlive_steps_resets_and_the_end(units: dict[str, Path], version: str) -> None:
    with FMUInstance(units[version]) as unit:
        slave: Any = unit._slave
        state = unit.get_state()
        after = go_on(unit)
        for spoil in ("steps", "reset", "terminate"):
            if spoil == "reset":
                unit.reset()
            elif spoil == "terminate":
                slave.call(slave.fmu.terminate)
            unit.set_state(state)
            assert go_on(unit) == after, spoil


@pytest.mark.parametrize(("version", "n"), [*((v, 100) for v in VERSIONS), *(slow((v, 1000)) for v in VERSIONS)])
def test_a_thousand_instances(units: dict[str, Path], version: str, n: int) -> None:
    """Each of its own; every tenth is freed while the others live."""
    with ExitStack() as stack:
        many = [stack.enter_context(FMUInstance(units[version], name="the same name")) for _ in range(n)]
        for i, unit in enumerate(many):
            unit.set_input([1e-3 * i])
            unit.do_step(0.0, H)
        for unit in many[::10]:
            unit.close()
        left = [(i, u) for i, u in enumerate(many) if i % 10]
        q = np.array([u.get(["q", "v"]) for _, u in left])
        slope = (q[-1] - q[0]) / (left[-1][0] - left[0][0])
        line = q[0] + np.outer([i - left[0][0] for i, _ in left], slope)
        assert np.abs(q - line).max() <= 1e-14 and np.abs(slope).min() > 1e-8, "linear in the force of each"


# -- odd steps -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_odd_steps(units: dict[str, Path], version: str) -> None:
    """Refused in words that name the number, or rounding of a clock; what follows has the bits of a run without them."""
    with FMUInstance(units[version], stop=1.0) as unit, FMUInstance(units[version], stop=1.0) as plain:
        assert go_on(unit) == go_on(plain)
        t = 5 * H
        odd: list[tuple[float, float, str]] = [
            (t, 0.0, "must be positive and finite"),
            (t, -0.0, "must be positive and finite"),
            (t, -H, "a step of -0.1 s"),
            (t, float("nan"), "must be positive and finite"),
            (t, float("inf"), "must be positive and finite"),
            (float("nan"), H, "must be positive and finite"),
            (t - H, H, "the component is at t = "),
            (t + 1e-3, H, "the component is at t = "),
            (t, 0.6, "after the stop time 1 s"),
            (t, 1e300, "after the stop time 1 s"),
        ]
        for time, h, words in odd:
            with pytest.raises(StepFailure, match=words):
                unit.do_step(time, h)
        for h in (5e-324, 1e-300, 1e-30, 1e-17):
            unit.do_step(t, h)
        assert go_on(unit, first=5) == go_on(plain, first=5)
        with pytest.raises(StepFailure, match="after the stop time"):
            unit.do_step(1.0, H)


@pytest.mark.parametrize("version", VERSIONS)
def test_steps_beyond_all_numbers_are_refused_without_a_stop_time(units: dict[str, Path], version: str) -> None:
    with FMUInstance(units[version]) as unit:
        before = bits(unit)
        with pytest.raises(StepFailure, match="would be 1e.301 internal steps"):
            unit.do_step(0.0, 1e300)
        assert bits(unit) == before
