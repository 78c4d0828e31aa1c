"""Couplings of members at their limits: runaways, stiff joints, rates 1 : 1000, loops without states, other orders of members."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from phfmu.studies.stress.case import StressCase, StressOutcome
from phfmu.studies.stress.drive import instance
from phfmu.studies.stress.members.coupled import stiff_pair


def coupled(net: Any, coupling: Any = None, parts: dict[str, int] | None = None, threads: int | None = None) -> Any:
    """Members of a network stepped apart, by Newton's method if no other coupling is given."""
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.network.couplings.newton import newton
    from phfmu.network.members.engine_member import EngineMember

    units = {n: instance(replace(d, name=n)) for n, d in net.members.items()}
    members: list[Any] = [EngineMember(n, u.model, u, (parts or {}).get(n, 1)) for n, u in units.items()]
    return Coupled(net, members, newton if coupling is None else coupling, threads=threads)


def run(stepper: Any, stop: float, step: float, **more: Any) -> Any:
    from phfmu.runs.loop import run as run_
    from phfmu.runs.options import Options

    return run_(stepper, Options(stop=stop, step=step, **more))


def left(summary: Any) -> float:
    """|dH + D - E_ext - junction energies| relative to the energies in play."""
    n = summary.network
    made = sum(j.residual for j in summary.junctions)
    play = sum(abs(c.stored) + abs(c.supplied) + abs(c.dissipated) + abs(c.H_start) for c in summary.components)
    return abs(n.stored + (n.dissipated or 0.0) - (n.external or 0.0) - made) / max(play, 1e-300)


def oscillator() -> Any:
    from phfmu.components.scenes.mechanical.oscillator import oscillator as scene

    return scene().system


def runaway() -> StressOutcome:
    """Jacobi at 0.04 s: every step before the end is accounted for, and the end comes with advice."""
    from phfmu import StepFailure
    from phfmu.network.couplings.jacobi import Jacobi
    from phfmu.outcome.status import Status, remedy

    stepper, worst = coupled(oscillator(), Jacobi()), 0.0
    stepper.check_start()
    stepper.prepare(0.0, 0.04)
    for k in range(1000):
        try:
            s = stepper.advance(0.0, 0.04, 1, k)
        except StepFailure as failure:
            told = failure.status is Status.GROWTH and bool(remedy(failure))
            text = f"stopped at t = {failure.time:.3g} s, {'with' if told else 'without'} advice; unexplained {worst:.1e} H"
            return StressOutcome(text, told and worst <= 1e-12)
        worst = max(worst, abs(s.stored.sum() - s.pairs.sum()) / float(np.abs(s.H).sum()))
    return StressOutcome("went on for 1000 steps", False)


def explicit(name: str) -> StressOutcome:
    """At 0.01 s for 1 s."""
    from phfmu.network.couplings.coupling_table import COUPLINGS

    s = run(coupled(oscillator(), COUPLINGS[name].kind()), 1.0, 0.01).ledger.summary()
    made = sum(j.residual for j in s.junctions)
    return StressOutcome(
        f"junctions made {made:.3g} J of 98.7, unexplained {left(s):.1e}", left(s) <= 1e-12 and abs(made) > 1e-3
    )


def accelerated(k: float) -> StressOutcome:
    """Anderson's acceleration on a stiff pair."""
    from phfmu.network.couplings.anderson import Anderson

    result = run(coupled(stiff_pair(k), Anderson()), 1.0, 0.01)
    off = float(np.abs(result.column("m1.q") - 0.1 * np.sin(10.0 * result.time)).max())
    trials = result.iterations / result.steps
    return StressOutcome(f"{trials:.1f} trials a step, error {off:.1e} m, unexplained {left(result.ledger.summary()):.1e}",
                   trials <= 12 and off <= 2e-3)  # fmt: skip


def weightless() -> StressOutcome:
    """A mass between dampers, which have no states: v' = -8 v, in each step the midpoint rule."""
    from phfmu import Network
    from phfmu.components.mechanical.translational import damper, mass, spring

    net = Network("weightless")
    net.add("m", mass(1.0, v=1.0))
    net.add("d1", damper(3.0))
    net.add("d2", damper(5.0))
    net.add("s", spring(1e-9))
    net.junction("left", ["m.flange", "d1.a", "d2.a", "s.a"])
    result = run(coupled(net), 0.5, 0.01)
    v, h = result.column("m.v"), 0.01
    exact = ((1.0 - 4.0 * h) / (1.0 + 4.0 * h)) ** np.arange(len(v))
    off, trials = float(np.abs(v - exact).max()), result.iterations / result.steps
    return StressOutcome(
        f"{trials:.1f} trials a step, {off:.1e} from the midpoint rule by hand", off <= 1e-9 and trials <= 2.5
    )


def rates() -> StressOutcome:
    """A light mass on a stiff spring takes 1000 steps in each of the heavy one's."""
    from phfmu import Network
    from phfmu.components.mechanical.translational import mass, spring

    net = Network("rates")
    net.add("m", mass(1.0, k=1.0, q=1.0))
    net.add("light", mass(1e-3))
    net.add("s", spring(1e3, elongation=-1.0))
    net.connect("m.flange", "s.a", name="left")
    net.connect("light.flange", "s.b", name="right")
    s = run(coupled(net, parts={"light": 1000, "s": 1000}), 0.5, 0.01).ledger.summary()
    drift = abs(s.network.stored) / 500.5
    return StressOutcome(
        f"energy {drift:.1e} H0, ledger {'closed' if s.closed else 'open'}", s.closed and drift <= 1e-11
    )


def partial() -> StressOutcome:
    """A stiffness that changes off the grid, and a last step that is cut short."""
    from phfmu import Event

    result = run(coupled(stiff_pair(1e4)), 0.503, 0.01, events=(Event(0.1234, "s.k", 2e4),))
    s = result.ledger.summary()
    text = f"{result.steps} steps to t = {result.time[-1]:g} s, ledger {'closed' if s.closed else 'open'}"
    return StressOutcome(text, s.closed and result.steps == 51 and result.time[-1] == 0.503)


def shuffled(names: Sequence[str]) -> StressOutcome:
    """The members in another order: the same motion and energies."""
    from phfmu import Network

    first: Any = stiff_pair(1e4)
    other = Network(first.name, {n: first.members[n] for n in names}, list(first.junctions))
    one, two = (run(coupled(net), 1.0, 0.01) for net in (first, other))
    off = max(float(np.abs(one.column(n) - two.column(n)).max()) for n in ("m1.q", "m2.v", "s.e", "s.energy.stored"))
    return StressOutcome(f"{off:.1e} apart", off <= 1e-13)


def struck() -> StressOutcome:
    """A force that begins off the grid of steps: the grid lands on it."""
    from phfmu import Event, Network
    from phfmu.components.mechanical.translational import mass

    net = Network("struck")
    net.add("m", mass(2.0))
    net.add("far", mass(1.0))
    result = run(coupled(net), 1.0, 0.1, events=(Event(0.37, "m.flange.force", 4.0),))
    s = result.ledger.summary()
    off = abs(float(result.column("m.v")[-1]) - 2.0 * 0.63)
    return StressOutcome(
        f"velocity {off:.1e} m/s from exact, unexplained {left(s):.1e}", off <= 1e-13 and left(s) <= 1e-14
    )


CASES = (
    StressCase("oscillator", "jacobi, h = 0.04 s: diverges", "stopped with advice; unexplained <= 1e-12 until then", runaway),
    *(StressCase("oscillator", f"{n}, h = 0.01 s", "every joule is told: unexplained <= 1e-12", lambda n=n: explicit(n))
      for n in ("gauss-seidel", "jacobi")),
    *(StressCase("stiff_pair", f"anderson, spring of {k:.0e} N/m, h = 0.01 s", "error <= 2e-3 m, 12 trials a step at most",
            lambda k=k: accelerated(k)) for k in (1e4, 1e8, 1e10)),
    StressCase("dampers", "a mass on two dampers, members apart", "the midpoint rule to 1e-9, 2.5 trials a step", weightless),
    StressCase("rates", "members 1 : 1000", "closed, energy <= 1e-11 H0", rates),
    StressCase("stiff_pair", "an event off the grid, a last step cut short", "closed, ends on time", partial),
    StressCase("stiff_pair", "members in another order", "the same to 1e-13", lambda: shuffled(("s", "m2", "m1"))),
    StressCase("struck", "a force that begins off the grid", "landed on: exact", struck),
)  # fmt: skip
