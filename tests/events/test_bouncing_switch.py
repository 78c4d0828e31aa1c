"""A contact with restitution that is a `Switch`: it throws back until it comes to rest, and then holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    DeclarationError,
    FMUInstance,
    Monolithic,
    NativeInstance,
    Options,
    Switch,
    algebraic,
    build_model,
    check,
    energy,
    export,
    parameter,
    run,
    skew,
    state,
)
from phfmu.components.mechanical.contacts import end_stop
from phfmu.engine.switched import stepped

G, M, HEIGHT = 9.81, 0.7, 1.0


def ball(e: Any = 0.5, **changes: Any) -> PHDAE:
    """A ball of 0.7 kg over a floor, from 1 m."""
    q, v = state("q", unit="m", start=HEIGHT), state("v", unit="m/s")
    force, touches = algebraic("N", unit="N", nominal=10.0), parameter("touches", 0.0)
    floor = Switch("floor", force, {v: 1.0}, touches, **{"gap": q, "unit": "m", "restitution": e} | changes)
    return PHDAE(
        "ball",
        states=(q, v),
        algebraics=(force,),
        parameters=(touches,),
        energies=(energy(M * v**2 / 2), energy(M * G * q.sx)),
        E={v: M},
        structure=(skew(q, v, 1.0),),
        switches=(floor,),
    )


def bounced(k: int, declaration: PHDAE, stop: float = 1.8, step: float = 0.02) -> Any:
    model = build_model(declaration, Collocated(k))
    return run(Monolithic(model, stepped(model, NativeInstance)), Options(stop=stop, step=step))


@pytest.mark.parametrize("k", [1, 2])
def test_it_bounces_at_the_times_of_the_formula_and_comes_to_rest(k: int) -> None:
    """t_n = t_0 (1 + 2 e (1 - e^n)/(1 - e)), each loses (1 - e^2)/2 m v^2; all of m g h is lost, then the floor bears m g."""
    result, e = bounced(k, ball()), 0.5
    fall, told = np.sqrt(2 * HEIGHT / G), [n for n in result.notes if "floor.closes" in n]
    times = [float(n.split("t = ")[1].split(" s")[0]) for n in told]
    wanted = [fall * (1 + 2 * e * (1 - e**n) / (1 - e)) for n in range(len(times))]
    assert len(times) > 10 and times[:12] == pytest.approx(wanted[:12], rel=1e-11)
    lost = [float(n.rpartition("lost ")[2].removesuffix(" J")) for n in told[:6]]
    assert lost == pytest.approx([(1 - e**2) * e ** (2 * n) * M * G * HEIGHT for n in range(6)], rel=1e-8)
    assert "floor on" in told[-1] and result.column("touches")[-1] == 1.0
    assert abs(result.column("q")[-1]) < 1e-12 and abs(result.column("v")[-1]) < 1e-12
    assert result.column("N_end")[-1] == pytest.approx(M * G, rel=1e-12)
    summary = result.ledger.summary()
    assert summary.closed and summary.components[0].jumps == pytest.approx(-M * G * HEIGHT, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_unit_bounces_as_the_native_engine_does(version: str, tmp_path: Path) -> None:
    """With a restitution that is a parameter: states, mode and losses after it has come to rest."""
    e = parameter("e", 0.5, min=0.0, max=1.0)
    thrown = ball(e.sx)
    model = build_model(replace(thrown, parameters=(*thrown.parameters, e)), Collocated(2))
    (path,) = export(model, tmp_path, (version,), step=0.02)
    result = bounced(2, ball())
    with FMUInstance(path) as unit:
        for i in range(90):
            unit.do_step(i * 0.02, 0.02)
        q, v, on, jumped = unit.get(["q", "v", "mode.touches", "energy.events"])
    assert [q, v] == pytest.approx([result.column("q")[-1], result.column("v")[-1]], abs=1e-13) and on == 1.0
    assert jumped == pytest.approx(-M * G * HEIGHT, rel=1e-12)


def test_a_hundred_impacts_in_one_step_end_at_rest() -> None:
    """e = 0.95: the hundredth still has 4e-5 of the first one's energy, and its contact takes it all."""
    result = bounced(2, ball(0.95), 40.0, 40.0)
    assert len([n for n in result.notes if "floor.closes" in n]) == 100 and "comes to rest" in result.notes[-1]
    assert result.ledger.summary().components[0].jumps == pytest.approx(-M * G * HEIGHT, rel=1e-10)


def test_without_restitution_it_holds_at_once() -> None:
    result = bounced(2, ball(0.0), 0.6)
    assert len(result.notes) == 1 and "floor on" in result.notes[0]
    assert result.ledger.summary().components[0].jumps == pytest.approx(-M * G * HEIGHT, rel=1e-12)


def test_what_no_impulse_acts_on_is_refused_by_name() -> None:
    """Ports, whose velocity others give; a switch that has no gap to close; restitutions that make energy."""
    stop = end_stop()
    thrown = replace(stop, switches=tuple(replace(s, restitution=0.5) for s in stop.switches))
    for model, words in ((thrown, "stands on a, b, on which no impulse acts"), (ball(gap=None), "no gap that closes")):
        (problem,) = [p for p in check(model) if "restitution" in p.reason]
        assert problem.entry == "switch 'contact'" if model is thrown else "switch 'floor'" and words in problem.reason
        with pytest.raises(DeclarationError, match=words):
            build_model(model)
    assert any("is 1.5" in p.reason for p in check(ball(1.5)))
