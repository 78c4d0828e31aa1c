"""Orders 2, 4 and 6 through events in exported units, stepped as importers do; their states are those of the native engine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    Event,
    FMUInstance,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    algebraic,
    build_model,
    damping,
    energy,
    export,
    run,
    skew,
    state,
    time,
)
from phfmu.components.electrical.branches import rl_branch
from phfmu.components.electrical.rectifiers import six_pulse_bridge
from phfmu.components.library import build
from phfmu.engine.switched import stepped
from phfmu.fmu.export.schedule import UnitEvent
from tests.events import scenes
from tests.events.test_isolated_neutral import BETWEEN, COMMAND, LS, exact, isolated
from tests.events.test_machine_breaker import OPEN
from tests.events.test_machine_breaker import declaration as machine

Array = Any


def star_rectifier() -> PHDAE:
    """Six diodes behind 0.05 ohm and 2 mH a phase whose sources meet at a star point that is joined to nothing else."""
    flux = state("flux", 3, unit="Wb", nominal=0.04)
    star = algebraic("star", unit="V", nominal=100.0)
    voltage = 100.0 * ca.vertcat(*(ca.cos(scenes.W * time + 0.4 - k * 2 * ca.pi / 3) for k in range(3)))
    source = PHDAE(
        "source",
        states=(flux,),
        algebraics=(star,),
        energies=(energy(ca.sumsqr(flux.sx) / 4e-3),),
        structure=(skew(flux, star, ca.DM.ones(3, 1)),),
        dissipation=(damping(flux, 0.05),),
        ports=(
            Port("terminal", ELECTRICAL, "effort", {flux: ca.DM.eye(3)}, size=3, nominal=100.0),
            Port("source", ELECTRICAL, "effort", {flux: ca.DM.eye(3)}, size=3, source=voltage, nominal=100.0),
        ),
    )
    net = Network("star_rectifier")
    net.add("grid", source)
    net.add("bridge", six_pulse_bridge(i=20.0, v=100.0))
    net.add("load", rl_branch(5.0, 20e-3, i=20.0, v=100.0))
    net.junction("ac", ["bridge.ac", "grid.terminal"])
    net.connect("bridge.dc", "load.terminal", name="dc")
    return net.compose()


@dataclass(frozen=True, eq=False)
class Case:
    """states: names of what is compared at `stop`, after `count` events; wanted: its values, None: those of a fine run.

    told: time, parameter, value of what happens by command;  steps: of each order
    """

    declared: Callable[[], PHDAE]
    states: Sequence[str]
    count: int
    stop: float
    steps: dict[int, Sequence[int]]
    told: tuple[tuple[float, str, float], ...] = ()
    wanted: Callable[[], Array] | None = None

    def native(self, k: int, n: int) -> Array:
        """States at the stop after n steps of the native engine."""
        model = built(self, k)
        options = Options(stop=self.stop, step=self.stop / n, events=tuple(Event(*e) for e in self.told))
        result = run(Monolithic(model, stepped(model, NativeInstance)), options)
        return np.array([result.column(name)[-1] for name in self.states])


def wall() -> Array:
    _, q, p = scenes.exact()
    return np.array([q, p])


CASES = {
    "wall": Case(scenes.wall, ("q", "p"), len(scenes.exact()[0]), scenes.WALL_STOP,
                 {1: (300, 600), 2: (75, 150), 3: (50, 100)}, wanted=wall),
    "bridge": Case(scenes.bridge, ("fa", "fd"), 11, scenes.BRIDGE_STOP, {1: (200, 400), 2: (100, 200), 3: (25, 50)}),
    "rectifier": Case(lambda: build("rectifier").declaration(), ("grid.flux", "load.flux"), 11, 0.05,
                      {1: (200, 400), 2: (100, 200), 3: (25, 50)}),
    "star": Case(star_rectifier, ("grid.flux[1]", "grid.flux[2]", "load.flux"), 11, 0.018,
                 {1: (180, 360), 2: (60, 120), 3: (36, 72)}),
    "poles": Case(isolated, ("source[1]", "source[2]", "source[3]"), 1, BETWEEN, {1: (264, 528), 2: (66, 132), 3: (33, 66)},
                  ((COMMAND, "command", 0.0),), lambda: exact()[3] * LS),
    "machine": Case(machine, ("gen.psi[4]", "gen.psi[5]", "gen.psi[6]"), 3, 0.03,
                    {1: (150, 300), 2: (60, 120), 3: (60, 120)}, ((OPEN, "line.command", 0.0),)),
}  # fmt: skip


@cache
def built(case: Case, k: int) -> Any:
    return build_model(case.declared(), Collocated(k))


@cache
def reference(case: Case) -> Array:
    return case.wanted() if case.wanted else case.native(3, 8 * case.steps[3][-1])


def stepwise(path: Path, case: Case, n: int) -> tuple[Array, float, float, float]:
    """States after n communication steps of a unit; events that it counted, what its books miss, and the energies in play."""
    moved = 0.0
    with FMUInstance(path) as unit:
        for i in range(n):
            unit.do_step(i * case.stop / n, (i + 1) * case.stop / n - i * case.stop / n)
            moved += unit.get(["energy.moved_step"])[0]
        values = unit.get([*case.states, "events.count", "energy.gap"])
    return values[:-2], values[-2], values[-1], moved


@pytest.mark.slow
@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("name", CASES)
def test_units_keep_the_order_through_events(name: str, k: int, tmp_path: Path) -> None:
    """FMI 2.0 and 3.0: slope 2k against the closed form or a fine run of order 6, the native engine's states, no gap in books."""
    case = CASES[name]
    model, steps = built(case, k), case.steps[k]
    paths = export(
        model,
        tmp_path,
        ("2.0", "3.0"),
        step=case.stop / steps[0],
        stop=case.stop,
        events=[UnitEvent(*e) for e in case.told],
    )
    scale = np.abs(reference(case)).max()
    for path in paths:
        errors = []
        for n in steps:
            x, count, gap, energies = stepwise(path, case, n)
            assert x == pytest.approx(case.native(k, n), rel=1e-11, abs=1e-13 * scale)
            assert count == case.count and abs(gap) < 1e-13 * energies
            errors.append(np.abs(x - reference(case)).max())
        slope = np.log2(errors[0] / errors[1]) / np.log2(steps[1] / steps[0])
        assert slope == pytest.approx(2 * k, abs=0.25), errors
