"""Damping steps of members stepped apart: those of the composed model where members exchange values at nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    Event,
    Monolithic,
    NativeInstance,
    Options,
    PythonInstance,
    Radau,
    build_model,
    run,
)
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.components.scenes.electrical.breaker_opening import breaker_opening
from phfmu.network.couplings.anderson import Anderson
from phfmu.network.couplings.newton import newton
from phfmu.network.couplings.unconverged import HalvingPolicy
from tests.engines import ENGINES
from tests.events.stiff_fault import EVENTS, FAULT, STEP, STOP, T_FAULT, exact, network
from tests.network.both_loops import called_back
from tests.wide import longer, slow, wide


def apart(net: Any, scheme: Any, engine: Any = NativeInstance, coupling: Any = newton, **more: Any) -> Coupled:
    models = {n: build_model(d, scheme) for n, d in net.declared.items()}
    return Coupled(net, [EngineMember(n, m, engine(m)) for n, m in models.items()], coupling, **more)


def composed(net: Any, scheme: Any) -> Monolithic:
    model = build_model(net.compose(), scheme)
    return Monolithic(model, NativeInstance(model))


def require_same(a: Any, b: Any, names: list[str]) -> None:
    """Rows at the same times with the same values of the states, to rounding; ledgers closed, as many damped steps."""
    np.testing.assert_allclose(a.time, b.time, rtol=1e-13)
    for name in names:
        size = np.abs(b.column(name)).max()
        np.testing.assert_allclose(a.column(name), b.column(name), rtol=0, atol=1e-11 * size, err_msg=name)
    assert a.ledger.summary().closed and b.ledger.summary().closed
    assert a.restarted == b.restarted


@pytest.mark.parametrize(
    ("engine", "k"),
    [
        (NativeInstance, 1), slow((NativeInstance, 2)), slow((NativeInstance, 3)),
        *longer(((PythonInstance, k) for k in (1, 2, 3)), (PythonInstance, 2)),
    ],
)  # fmt: skip
def test_a_fault_at_a_bare_node_is_damped_as_composed(k: int, engine: Any) -> None:
    """T = 14 us in steps of 100 us; without damping the charge of the load is off by more than its size a step later."""
    scene = build("two_machine")
    options = {"stop": 0.104, "step": scene.step, "events": scene.events}
    whole = run(composed(scene.system, Collocated(k)), Options(**options, restart=2))
    found = run(apart(scene.system, Collocated(k), engine), Options(**options, restart=2))
    assert found.restarted == 2
    names = [n for n in whole.names if ".psi[" in n or ".charge[" in n or n == "m1.theta"]
    assert len(names) > 8
    require_same(found, whole, [n for n in names if "m1.psi[3]" != n and "m2.psi[3]" != n])
    lost = [sum(c.numerical or 0.0 for c in r.ledger.summary().components) for r in (found, whole)]
    assert lost[0] == pytest.approx(lost[1], rel=1e-9) and lost[0] > 0


@pytest.mark.parametrize("k", [slow(2), 3])
def test_members_that_land_together_damp_the_rest_of_the_step_too(k: int) -> None:
    """Three poles open one after the other: damped steps after each, and the rest of each step with one."""
    net, options = breaker_opening(0.0203, chop=0.5).system, Options(
        stop=0.03, step=4e-4, events=(Event(0.0203, "line.command", 0.0),), restart=2
    )  # fmt: skip
    coupled = apart(net, Collocated(k))
    assert coupled.lands
    found, whole = run(coupled, options), run(composed(net, Collocated(k)), options)
    assert found.restarted == 11
    require_same(found, whole, [f"load.charge[{i}]" for i in (1, 2, 3)] + ["line.flux[2]"])
    assert found.ledger.summary().events == {"parameter": 1, "state": 3}


@pytest.mark.parametrize("k", wide([1, 2, 3], 2))
def test_with_signals_and_events_inside_a_member(k: int) -> None:
    """The fault's current is 5.1 kA at most; without damping it is off by 4.8, 1.3 and 0.2 kA."""
    rings = run(apart(network(), Collocated(k)), Options(stop=STOP, step=STEP, events=EVENTS))
    damped = run(apart(network(), Collocated(k)), Options(stop=STOP, step=STEP, events=EVENTS, restart=2))

    def error(result: Any) -> float:
        at = result.time / STEP
        on = (result.time > T_FAULT + 3.5 * STEP) & (np.abs(at - np.round(at)) < 1e-6)
        return float(np.abs(result.column("bus.i_fault")[on] - FAULT * exact(result.time[on])[0][:, 1]).max())

    assert error(rings) > {1: 4000, 2: 1000, 3: 150}[k] and error(damped) < 30
    # two after the fault, two after the step with the limit in it
    assert damped.restarted == 4
    assert damped.ledger.summary().closed and damped.ledger.summary().events == {"parameter": 1, "state": 1}


@pytest.mark.parametrize("how", ["called back", "halved"])
def test_loops_and_policies_take_the_same_damped_steps(how: str) -> None:
    options = Options(stop=0.008, step=STEP, events=EVENTS, restart=2)
    usual = run(apart(network(), Collocated(2)), options)
    if how == "halved":
        other = run(apart(network(), Collocated(2), coupling=lambda joined: HalvingPolicy(newton(joined))), options)
    else:
        other = run(called_back(apart(network(), Collocated(2))), options)
    require_same(other, usual, ["bus.q", "source.flux", "exciter.E"])


@pytest.mark.parametrize("engine", wide(ENGINES, NativeInstance))
def test_all_steps_damped_apart_are_those_of_the_composed_model(engine: Any) -> None:
    """Values at the Radau nodes are exchanged; held ones were off by the second power of the step."""
    scene = build("two_machine")
    options = Options(stop=0.02, step=scene.step)
    found, whole = run(apart(scene.system, Radau(2), engine), options), run(composed(scene.system, Radau(2)), options)
    assert found.ledger.summary().closed
    for name in ("load.charge[1]", "m1.psi[1]", "m2.theta"):
        size = np.abs(whole.column(name)).max()
        np.testing.assert_allclose(found.column(name), whole.column(name), rtol=0, atol=1e-11 * size)


def test_what_takes_no_damping_steps_is_refused_by_name() -> None:
    options = Options(stop=0.01, step=1e-3, restart=2)
    with pytest.raises(ValueError, match="--restart: members stepped apart take damping steps with --coupling newton"):
        run(apart(network(), Collocated(1), coupling=Anderson()), options)
    net = build("rectifier").system
    with pytest.raises(ValueError, match="--restart: member '[a-z]+' has ideal switches.*leave out --restart"):
        models = {n: build_model(d, Collocated(1)) for n, d in net.declared.items()}
        from phfmu.engine.switched import stepped

        run(Coupled(net, [EngineMember(n, m, stepped(m, NativeInstance)) for n, m in models.items()]), options)


def test_units_are_refused_by_name(capsys: Any) -> None:
    assert main(["run", "oscillator", "--coupling", "newton", "--engine", "fmu", "--restart", "1"]) == 2
    told = capsys.readouterr().err
    assert "is a unit, which has its scheme compiled in" in told and "leave out --restart" in told


def test_the_command_line_damps_members_apart(capsys: Any) -> None:
    words = ["run", "two_machine", "--coupling", "newton", "--stop", "0.102", "--restart", "2"]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "restarted after events with 2 damping steps" in told and "ringing" not in told
