"""Values no model was made for: refused with the state back, in bounded work; nothing is read that is not finite."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu import NativeInstance, PythonInstance, Status, StepFailure, TwoLevel, build_model
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.translational import mass
from phfmu.outcome.limits import LIMITS
from tests.engines import ENGINES

#: the attempt that is under way may end: 30 iterations, or 120 where it grows from an eighth of the step
LAST = 120


def fingerprint(instance) -> dict[str, bytes]:
    return {name: values.tobytes() for name, values in instance.signals().items()}


@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("engine", ENGINES)
def test_an_energy_that_overflows_refuses_the_step(engine, parts: int) -> None:
    """The state it would lead to is finite, 1e155 m/s; the energy of the step is not."""
    instance = engine(build_model(mass(1.0)))
    instance.set_input([1.0])
    instance.do_step(0.0, 1.0)
    before = fingerprint(instance)
    instance.set_input([1e155])
    with pytest.raises(StepFailure) as error:
        instance.do_step(1.0, 1.0, parts)
    assert error.value.status is Status.NOT_FINITE
    instance.set_input([1.0])
    assert fingerprint(instance) == before
    instance.do_step(1.0, 1.0, parts)
    assert instance.x[-1] == pytest.approx(2.0)


@pytest.mark.parametrize("engine", ENGINES)
def test_cumulative_energies_stay_finite(engine) -> None:
    """A force of 1e150 N gives 5e299 k^2 J by the end of step k."""
    instance = engine(build_model(mass(1.0)))
    instance.set_input([1e150])
    taken = 0
    with np.errstate(all="ignore"), pytest.raises(StepFailure) as error:
        for k in range(100):
            instance.do_step(float(k), 1.0)
            assert all(np.isfinite(v).all() for v in instance.signals().values())
            taken += 1
    assert error.value.status is Status.NOT_FINITE and 1 < taken < 99
    assert all(np.isfinite(v).all() for v in instance.ledger().values())


@pytest.mark.parametrize("engine", ENGINES)
def test_a_stored_energy_that_is_not_finite_is_told(engine) -> None:
    instance = engine(build_model(mass(1.0)))
    instance.set_x(0.0, [0.0, 1e160])
    with np.errstate(all="ignore"), pytest.raises(StepFailure, match="not finite"):
        instance.initialise()


@pytest.mark.slow
def test_the_work_of_a_step_is_bounded() -> None:
    """Thrown states of the four particles at order 6; the worst of these took thousands of iterations."""
    model = build_model(four_particle(), TwoLevel(3))
    instance, rng = NativeInstance(model), np.random.default_rng(1)
    start, most, told = instance.get_state(), 0, False
    drawn = [
        (10 ** rng.uniform(-1, 8) * rng.standard_normal(model.step.nx), 10 ** rng.uniform(-3, 1)) for _ in range(150)
    ]
    for thrown, h in drawn[130:]:
        instance.set_state(start)
        instance.set_x(0.0, model.x0 + thrown)
        before = instance.counts["iterations"]
        try:
            instance.do_step(0.0, h)
        except StepFailure as failure:
            if failure.spent >= LIMITS["MOST_ITERATIONS"]:
                told = f"{failure.spent} with all attempts: no" in str(failure)
        most = max(most, instance.counts["iterations"] - before)
    assert LIMITS["MOST_ITERATIONS"] <= most <= LIMITS["MOST_ITERATIONS"] + LAST and told


def test_the_python_engine_ends_at_the_same_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    model = build_model(four_particle(), TwoLevel(3))
    instance, rng = PythonInstance(model), np.random.default_rng(1)
    monkeypatch.setitem(LIMITS, "MOST_ITERATIONS", 60.0)
    monkeypatch.setitem(LIMITS, "MORE_ITERATIONS", 10.0)
    instance.set_x(0.0, model.x0 + 1e3 * rng.standard_normal(model.step.nx))
    with np.errstate(all="ignore"), pytest.raises(StepFailure, match=r"(6|7|8)\d with all attempts: no step"):
        instance.do_step(0.0, 1.0)
