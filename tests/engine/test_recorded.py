"""What instances record of their steps: names that there are, and a remedy for others; blocks of a row in both engines."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Guard,
    Jump,
    NativeInstance,
    PythonInstance,
    StateEvent,
    StepFailure,
    SwitchedInstance,
    build_model,
    energy,
    skew,
    state,
)
from phfmu.components.electrical.rectifiers import rectifier_bridge
from phfmu.engine.record import RECORD


@cache
def model(events: bool) -> Any:
    q, p = state("q", start=0.1), state("p", start=-1.0)
    hit = StateEvent(Guard("hit", q, -1), jump=Jump({p: 1.0}, 0.5))
    return build_model(
        PHDAE(
            "oscillator", states=(q, p), energies=(energy((p**2 + q**2) / 2),), structure=(skew(q, p, 1.0),),
            state_events=(hit,) if events else (),
        )
    )  # fmt: skip


@pytest.mark.parametrize(
    ("engine", "events"), [(PythonInstance, False), (NativeInstance, False), (NativeInstance, True)]
)
def test_names_that_cannot_be_recorded_are_told_with_those_that_can(engine: Any, events: bool) -> None:
    instance = engine(model(events))
    for take in (instance.run, instance.land)[: 1 + events]:
        with pytest.raises(ValueError, match="oscillator: there is no record 'H'; there are: signals, .* energy"):
            list(take(0.0, 0.01, 5, ("x", "H")))
        with pytest.raises(ValueError, match="no record 'energi'; did you mean energy?"):
            list(take(0.0, 0.01, 5, ("energi",)))
    assert instance.time == 0.0 and instance.counts["steps"] == 0


def test_a_model_with_switches_tells_it_too() -> None:
    instance = SwitchedInstance(build_model(rectifier_bridge()), NativeInstance)
    with pytest.raises(ValueError, match="no record 'H'"):
        list(instance.land(0.0, 1e-5, 1, ("H",)))


@pytest.mark.parametrize(
    ("engine", "events"), [(PythonInstance, False), (NativeInstance, False), (NativeInstance, True)]
)
def test_rows_are_the_blocks_one_after_the_other(engine: Any, events: bool) -> None:
    instance = engine(model(events))
    rows = instance.run(0.0, 0.01, 20, RECORD)
    assert {name: len(r) for name, r in rows.items()} == dict.fromkeys(RECORD, 20)
    assert (rows["signals"][-1] == instance.row()).all() and len(instance.row()) == instance.layout["H"].stop
    for block, values in instance.signals().items():
        assert (rows["signals"][-1, instance.layout[block]] == values).all()
        assert (instance.signal(block) == values).all()


def test_blocks_of_the_past_are_told_where_the_present_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    instance = PythonInstance(model(False))
    instance.do_step(0.0, 0.01)

    def refused(_: Any) -> Any:
        raise StepFailure

    monkeypatch.setattr(instance._present, "values", refused)
    assert np.isfinite(instance.signal("x")).all() and (instance.signal("x") == instance.x).all()
