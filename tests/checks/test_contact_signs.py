"""Contacts whose column has the wrong sign are told, with the column that is right; a diode of either polarity is a diode."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from phfmu import PHDAE, Network, check, time
from phfmu.components.electrical.switches import diode
from phfmu.components.mechanical.contacts import bumper, end_stop, impact_pair
from phfmu.components.mechanical.translational import mass
from tests.events.scenes import lifted


def turned(model: PHDAE) -> PHDAE:
    """With the columns of its contacts turned round."""
    if model.switches:
        return replace(model, switches=tuple(replace(s, on={v: -m for v, m in s.on.items()}) for s in model.switches))
    events = [
        replace(e, jump=e.jump and replace(e.jump, on={v: -m for v, m in e.jump.on.items()}))
        for e in model.state_events
    ]
    return replace(model, state_events=tuple(events))


def between() -> PHDAE:
    """A stop between two bodies, whose velocities are given from inside."""
    net = Network("between")
    net.add("stop", end_stop())
    for side in ("a", "b"):
        net.add(side, mass(1.0))
        net.connect(f"stop.{side}", f"{side}.flange")
    return net.compose()


CASES = {
    "floor": (lambda: lifted(9.0 * time), "switch 'floor'", "{p: 1}"),
    "stop": (end_stop, "switch 'contact'", "{a: -1, b: 1}"),
    "between": (between, "switch 'stop.contact'", "{stop.a: -1, stop.b: 1}"),
    "bumper": (bumper, "jump 'hits'", "{v: 1}"),
    "pair": (impact_pair, "jump 'hits'", "{v_a: -1, v_b: 1}"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_contact_that_pulls_is_told_with_the_column_that_pushes(name: str) -> None:
    make, entry, column = CASES[name]
    assert not any("gap opens" in p.reason for p in check(make()))
    (problem,) = [p for p in check(turned(make())) if "gap opens" in p.reason]
    assert problem.entry == entry and column in problem.remedy and problem.severity == "error"


@pytest.mark.parametrize("change", [lambda d: d, turned])
def test_what_has_no_gap_has_no_wrong_sign(change: Any) -> None:
    assert not any("gap opens" in p.reason for p in check(change(diode())))
