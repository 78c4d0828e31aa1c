"""Scenes of the library with state events at ten and a thousand times their length: they go on, closed, and lose no event."""

from __future__ import annotations

from math import log
from typing import Any

import numpy as np
import pytest

from phfmu import Collocated, Monolithic, NativeInstance, Options, build_model, run
from phfmu.components.library import build
from phfmu.engine.switched import stepped
from tests.events.exact_buck import exact

#: scene -> events in ten times and in a thousand times its length, by hand or by count in a length: settled ones have no more
SCENES = {
    "bouncing_ball": (None, None),
    "buffer": (28, 28),
    "hard_stop": (2, 2),
    "clutch_engagement": (2, 2),
    "two_point_control": (78, 7992),
    "breaker_opening": (3, 3),
    "rectifier": (101, 10001),
    "six_pulse": (120, 12000),
    "buck": (1204, 120004),
    "bead": (1, 1),
    "smib_breaker": (7, None),
}


def long(name: str, times: int, k: int) -> tuple[Any, Any]:
    """The instance at the end and the result of a run."""
    scene = build(name)
    model = build_model(scene.declaration(), None if name == "bead" else Collocated(k))
    made = stepped(model, NativeInstance)
    options = Options(stop=times * scene.stop, step=scene.step, events=scene.events, every=1000)
    return made, run(Monolithic(model, made), options)


def require_as_expected(name: str, times: int, k: int) -> Any:
    made, result = long(name, times, k)
    summary = result.ledger.summary()
    count, expected = summary.events.get("state", 0), SCENES[name][0 if times == 10 else 1]
    print(f"{name} {times} times, order {2 * k}: {count} state events")
    assert summary.closed and np.isfinite(made.x).all()
    if expected is not None:
        assert abs(count - expected) <= max(1, 2e-3 * expected)
    return made


@pytest.mark.slow
@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("name", SCENES)
def test_ten_times_as_long(name: str, k: int) -> None:
    require_as_expected(name, 10, k)


LONG = [n for n, (_, many) in SCENES.items() if many or n == "bouncing_ball"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "k"), [(n, 1 + i % 3) for i, n in enumerate(LONG) if n != "buck"])
def test_a_thousand_times_as_long(name: str, k: int) -> None:
    require_as_expected(name, 1000, k)


@pytest.mark.long
def test_sixty_thousand_periods_of_a_converter_end_where_the_exact_stretches_do() -> None:
    """The steady state of a thousand lengths, which the exact solution has after a hundredth of that."""
    scene = build("buck")
    made = require_as_expected("buck", 1000, 3)
    assert made.x == pytest.approx(exact(0.03, lambda _: 0.6), rel=1e-6)
    assert scene.stop * 1000 == 3.0


@pytest.mark.slow
def test_a_rotor_between_two_speeds_takes_the_periods_of_its_exponentials() -> None:
    """Thousands of switchings, each period as long as two exponentials of J/d = 2.5 s."""
    _, result = long("two_point_control", 1000, 3)
    at = [float(n.split("=")[1].split()[0]) for n in result.notes if n.startswith("t = ")]
    period = 2.5 * (log((200 - 95) / (200 - 105)) + log(105 / 95))
    first = 2.5 * log((200 - 80) / (200 - 105))
    assert len(at) > 10 and at[0] == pytest.approx(first, rel=1e-9)
    assert np.diff(at[::2]) == pytest.approx(period, abs=2e-8)  # times are told with 12 digits
    assert (at[-1] - at[0]) / (len(at) - 1) == pytest.approx(period / 2, rel=1e-7)
