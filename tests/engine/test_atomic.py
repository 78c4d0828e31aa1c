"""A step whose end values are asked for and do not exist is not taken: state and ledger stay together."""

from __future__ import annotations

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Port,
    Status,
    StepFailure,
    algebraic,
    block,
    build_model,
    energy,
    state,
)
from tests.engines import ENGINES


def brake():
    """v' = F and 0 = -v^2 a + G: the force a has no value where v = 0, while means over a step have one."""
    v, a = state("v", unit="m/s", start=-1.0), algebraic("a", unit="m/s", start=1.0)
    ports = (Port("f", TRANSLATIONAL, "effort", {v: 1.0}), Port("g", TRANSLATIONAL, "effort", {a: 1.0}))
    return build_model(PHDAE("brake", states=(v,), algebraics=(a,), energies=(energy(0.5 * v.sx**2),), ports=ports,
                             dissipation=(block([a], v.sx**2),)))  # fmt: skip


@pytest.mark.parametrize("engine", ENGINES)
def test_run_takes_back_the_step_it_cannot_read(engine):
    unit = engine(brake())
    unit.set_input([1.0, 1.0])
    with pytest.raises(StepFailure, match="at t = 1 s") as failure:
        unit.run(0.0, 0.25, 8, ("x", "signals", "stored"))
    assert failure.value.status in (Status.SINGULAR, Status.NOT_FINITE)
    rows = failure.value.recorded
    assert len(rows["x"]) == len(rows["stored"]) == 3
    assert unit.time == 0.75 and unit.x == pytest.approx([-0.25]) and unit.counts["steps"] == 3
    assert np.sum(rows["stored"]) == pytest.approx(0.5 * (0.25**2 - 1.0), abs=1e-15)
    unit.do_step(0.75, 0.5)  # over the point that has no values
    assert unit.x == pytest.approx([0.25])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_step_without_reading_needs_no_end_values(engine):
    unit = engine(brake())
    unit.set_input([1.0, 1.0])
    assert unit.run(0.0, 0.25, 8, ("x",))["x"][-1] == pytest.approx([1.0])
