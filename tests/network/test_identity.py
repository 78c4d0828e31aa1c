"""Of every scene and coupling, converged or not: what is stored and dissipated is what came from outside and what junctions made.

dH + D - E_ext = sum of junction energies,       to 1e-12 of the energies in play.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from phfmu import (
    Anderson,
    Coupled,
    EngineMember,
    GaussSeidel,
    Jacobi,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    build_model,
    run,
)
from phfmu.components.library import LIBRARY, SWITCHED, build
from phfmu.engine.switched import stepped
from phfmu.network.couplings.newton import Newton, newton
from phfmu.network.couplings.unconverged import POLICIES
from phfmu.outcome.status import EventRefused, StepFailure
from tests.network.both_loops import impatient

STEPS = 6
#: what its junction exchanges is held by a signal, so no coupling can be late
HELD = {"speed_control"}
#: (step, stop) of scenes in which state events happen or modes change, so that some do
EVENTS = {
    "bouncing_ball": (0.02, 0.5), "buffer": (0.01, 0.13), "two_point_control": (0.05, 0.9), "breaker_opening": (1e-3, 0.024),
    "smib_breaker": (1e-3, 0.081), "hard_stop": (0.01, 0.18), "clutch_engagement": (0.02, 0.32), "rectifier": (5e-4, 6e-3),
    "six_pulse": (2.5e-4, 2e-3), "buck": (5e-6, 6e-5), "bead": (0.04, 0.8),
}  # fmt: skip
#: outputs of the step before make so much energy there that the run is stopped
STOPPED = {
    ("breaker_opening", "jacobi"),
    ("buck", "newton, stopped"),
    ("inrush", "gauss-seidel"),
    ("inrush", "jacobi"),
}
#: at rest in the steps that are taken: the first trial is the solution
STEADY = {"speed_control"}
SCENES = [n for n, (kind, *_) in LIBRARY.items() if kind == "scene"]
#: nodes where only inductive branches meet: no output gives their voltage at an instant
BARE = {
    "engine",
    "smib",
    "smib_hydro",
    "two_machine",
    "smib_breaker",
    "six_pulse",
    "motor_start",
    "wscc9",
    "wscc9_steady",
    "stall_start",
    "short_circuit",
}
QUICK = {"oscillator", "drive"}

COUPLINGS: dict[str, Callable[[Any], Any]] = {
    "newton": newton,
    "held": lambda _: Newton(),
    "anderson": lambda _: Anderson(),
    "gauss-seidel": lambda _: GaussSeidel(),
    "jacobi": lambda _: Jacobi(),
    "newton, stopped": lambda j: POLICIES["accept"](newton(j)),
    "held, stopped": lambda _: POLICIES["accept"](Newton()),
    "anderson, stopped": lambda _: POLICIES["accept"](Anderson()),
}


@cache
def models(name: str) -> tuple[Any, dict[str, Any]]:
    """The scene and the models of its members."""
    scene: Any = build(name)
    return scene, {n: build_model(d) for n, d in scene.system.members.items()}


def instance(model: Any) -> Any:
    return stepped(model, NativeInstance)


def stepper(name: str, coupling: str) -> tuple[Any, Any]:
    if coupling == "monolithic":
        scene = build(name)
        model = build_model(scene.declaration())
        return scene, Monolithic(model, instance(model))
    scene, parts = models(name)
    if coupling.startswith("newton") and scene.system.wires:  # signals at nodes
        parts = {n: build_model(d) for n, d in scene.system.separate().items()}
    members: list[Any] = [EngineMember(n, m, instance(m)) for n, m in parts.items()]
    return scene, Coupled(scene.system, members, COUPLINGS[coupling])


CASES = [
    pytest.param(name, coupling, marks=() if name in QUICK else pytest.mark.slow)
    for name in SCENES
    for coupling in ("monolithic", *(COUPLINGS if isinstance(build(name).system, Network) else ()))
]


@pytest.mark.parametrize(("name", "coupling"), CASES)
def test_the_identity_holds(name: str, coupling: str) -> None:
    kind, _, stopped = coupling.partition(", ")
    h, stop = EVENTS.get(name, (build(name).step, STEPS * build(name).step))
    try:
        scene, own = stepper(name, coupling)
        if stopped and isinstance(own, Coupled):
            impatient(own)
        options = Options(stop=stop, step=h, events=scene.events)
        if name in BARE and kind in ("gauss-seidel", "jacobi"):
            with pytest.raises(ValueError, match="no output gives"):
                run(own, options)
            return
        if (name, coupling) in STOPPED:
            with pytest.raises(StepFailure, match="grows without bound"):
                run(own, options)
            return
        result = run(own, options)
    except (ValueError, EventRefused) as refusal:  # what switches do is known where both sides of them are
        assert name in SWITCHED and coupling != "monolithic" and "switch" in str(refusal)
        return
    s = result.ledger.summary()
    n = s.network
    assert n is not None and (result.steps == STEPS or name in EVENTS)
    made = sum(j.residual for j in s.junctions)
    jumps = sum(c.jumps or 0.0 for c in s.components)
    in_play = sum(abs(c.stored) + abs(c.dissipated) + abs(c.supplied) for c in s.components) + sum(
        abs(p.supplied) for p in s.ports
    )
    if not s.ports:
        in_play += sum(c.H_start for c in s.components)
    left = n.stored + (n.dissipated or 0.0) - (n.external or 0.0) - made
    assert abs(left) <= 1e-12 * in_play
    rounding = 2.0 * np.finfo(float).eps * sum(c.H_start for c in s.components)
    assert n.stored == pytest.approx(
        sum(c.H_end - c.H_start for c in s.components) - jumps, abs=1e-12 * in_play + rounding
    )
    if name in EVENTS and not stopped:
        assert s.events["state"] >= 1
    if not stopped:
        closes = kind in ("monolithic", "newton", "held", "anderson") or name in HELD
        assert (abs(made) <= 1e-11 * in_play) is closes, "what is exact makes nothing, what is not must be seen"
    else:
        assert s.events.get("unconverged", 0) >= 2 or name in STEADY
    assert np.isfinite(result.values).all()
