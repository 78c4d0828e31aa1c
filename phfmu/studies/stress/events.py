"""State events at their limits: touches, groups, bounces without end, chatter, step ends, a hundred thousand of them."""

from __future__ import annotations

from dataclasses import replace
from math import cos, isclose, log, pi, sin, sqrt
from typing import Any

import numpy as np

from phfmu.studies.stress.case import StressCase, StressOutcome, refused
from phfmu.studies.stress.drive import instance
from phfmu.words import counted

G = 9.81
FALL = sqrt(2 / G)  # s, from 1 m


def ball(e: float, rest: bool = True) -> Any:
    """The library's ball from 1 m; `rest`: it may come to rest."""
    from phfmu.components.library import builder

    declaration = builder("bouncing_ball")(e=e).declaration()
    if rest:
        return declaration
    return replace(declaration, state_events=tuple(replace(s, rest={}) for s in declaration.state_events))


def landed(unit: Any, h: float, n: int) -> tuple[list[Any], float]:
    """Events in n steps from 0, and the energy that is missing, relative to that at the start."""
    before, happened, booked = unit.signal("H").sum(), [], 0.0
    for part in unit.land(0.0, h, n, record=("dissipated", "supplied")):
        if part.rows:
            booked += float(part.rows["dissipated"].sum() - part.rows["supplied"].sum())
        if part.happened is not None:
            happened.append(part.happened)
            booked += float(part.happened.lost.sum())
    return happened, float(abs(unit.signal("H").sum() - before + booked) / max(abs(before), 1e-300))


def late(happened: list[Any], times: list[float]) -> float:
    """Largest error of the times of events, infinite if they are not as many."""
    if len(happened) != len(times):
        return float("inf")
    return max((abs(e.t - t) for e, t in zip(happened, times, strict=True)), default=0.0)


def touch(depth: float, order: int) -> StressOutcome:
    """cos t turns `depth` beyond a guard, between step ends; below zero: before it."""
    from phfmu import PHDAE, Guard, StateEvent, energy, skew, state

    h = 2 * pi / 48
    q, p = state("q", unit="m", start=cos(-10.4 * h)), state("p", unit="kg.m/s", start=-sin(-10.4 * h))
    passed = StateEvent(Guard("passed", 1 - depth - q, 0, unit="m"))
    energies, structure = (energy(q**2 / 2), energy(p**2 / 2)), (skew(q, p, 1.0),)
    turning = PHDAE("turning", states=(q, p), energies=energies, structure=structure, state_events=(passed,))
    happened, missing = landed(instance(turning, order), h, 20)
    return StressOutcome(
        f"{counted(len(happened), 'event')}; energy {missing:.1e} H0",
        len(happened) == 2 * (depth > 0) and missing < 1e-14,
    )


def together() -> StressOutcome:
    """A rigid bar of 1 and 3 kg falls flat on both ends, e = 0.5."""
    from phfmu import Guard, Jump, StateEvent
    from phfmu.components.mechanical.multibody import Multibody

    body = Multibody("bar", 2)
    body.gravity([0.0, -G])
    ends = [body.particle(m, [x, 1.0], [0.0, 0.0]) for m, x in ((1.0, 0.0), (3.0, 2.0))]
    body.bar(ends[0], ends[1])
    declaration = body.build()
    q, v = declaration.states
    columns = np.eye(4)
    hits = tuple(
        StateEvent(
            Guard(f"end{i + 1}", q.sx[2 * i + 1], -1, unit="m"), jump=Jump({v: columns[:, 2 * i + 1].tolist()}, 0.5)
        )
        for i in range(2)
    )
    happened, _ = landed(instance(replace(declaration, state_events=hits)), 0.05, 12)
    lost = float(happened[0].lost.sum()) if happened else 0.0
    off = abs(lost / (0.75 * 4 * G) - 1)
    one = [h.events for h in happened] == [(0, 1)]
    return StressOutcome(
        f"{counted(len(happened), 'event')} of {len(happened[0].events)} guards; loss {off:.1e} off",
        one and off < 1e-12,
    )


def rests() -> StressOutcome:
    """Bounces end at FALL (1 + e)/(1 - e), and the ball has lost all it had."""
    unit = instance(ball(0.5), 4)
    happened, missing = landed(unit, 0.1, 20)
    end = 3 * FALL - max(h.t for h in happened)
    left = abs(unit.signal("H").sum()) / G
    said = f"{counted(len(happened), 'impact')}, at rest {end:.1e} s before the bounces end"
    said += f"; {left:.1e} H0 left, energy {missing:.1e} H0"
    return StressOutcome(said, 0 <= end < 1e-6 and left < 1e-12 and missing < 1e-13)


def endless() -> StressOutcome:
    from phfmu import StepFailure

    unit = instance(ball(0.5, rest=False), 4)
    return refused(lambda: landed(unit, 0.1, 20), StepFailure, "floor", "rest")


def relay(width: float) -> Any:
    """A rotor between 100 -+ width/2 rad/s."""
    from phfmu.components.library import builder

    return builder("two_point_control")(100 - width / 2, 100 + width / 2).declaration()


def busy() -> StressOutcome:
    """Ten switchings a step, at the times of the closed form."""
    width, tau = 0.1, 0.05 / 0.02
    a, b = 100 - width / 2, 100 + width / 2
    first, down, up = tau * log(120 / (200 - b)), tau * log(b / a), tau * log((200 - a) / (200 - b))
    times = [first + (i // 2) * (up + down) + (i % 2) * down for i in range(1000)]
    happened, missing = landed(instance(relay(width), 6), 0.02, 40)
    wanted = [t for t in times if t < 0.8]
    off = late(happened, wanted)
    return StressOutcome(
        f"{counted(len(happened), 'event')} in 40 steps, times {off:.1e} s off; energy {missing:.1e} H0",
        off < 1e-11 and missing < 1e-12,
    )


def chatter() -> StressOutcome:
    from phfmu import StepFailure

    return refused(
        lambda: landed(instance(relay(1e-6), 2), 0.02, 40), StepFailure, "relay.turns", "events fall into one step"
    )


def neutral() -> StressOutcome:
    """Three poles to an isolated star point: one opens alone, the other two carry one current and open together."""
    from phfmu import ELECTRICAL, PHDAE, Network, Port, algebraic
    from phfmu.components.electrical.breaker import breaker
    from phfmu.components.electrical.infinite_bus import infinite_bus

    v = algebraic("v", unit="V", nominal=300.0)
    port = Port("terminal", ELECTRICAL, "flow", {v: [[1.0, 1.0, 1.0]]}, size=3, nominal=100.0)
    net = Network("isolated")
    net.add("grid", infinite_bus(325.0, 50.0, 0.3, i=100.0))
    net.add("line", breaker(0.5, 0.01, i=100.0, v=325.0))
    net.add("star", PHDAE("star", algebraics=(v,), ports=(port,)))
    net.connect("grid.terminal", "line.a", name="bus")
    net.connect("line.b", "star.terminal", name="point")
    unit = instance(net.compose().with_starts({"line.command": 0.0}), 4)
    names = unit.model.events.names
    happened, _ = landed(unit, 2.5e-4, 160)
    told = [" and ".join(names[i].removeprefix("line.").removesuffix(".zero") for i in h.events) for h in happened]
    lost = max((abs(float(h.lost.sum())) for h in happened), default=1.0)
    alone = [len(h.events) for h in happened] == [1, 2] and not unit.x.any()
    return StressOutcome(f"{', then '.join(told)}; {lost:.1e} J lost, 0 A after it for 0.03 s", alone and lost < 1e-20)


def stiff(k: float) -> StressOutcome:
    """A wagon of 2 kg runs onto one of 1 kg that a spring of k N/m holds; the step is far above its period."""
    from phfmu import Network
    from phfmu.components.mechanical.contacts import end_stop
    from phfmu.components.mechanical.translational import mass

    net = Network("stiff")
    net.add("wagon", mass(2.0, v=1.0))
    net.add("stop", end_stop(0.105, nominal=0.1, f=1e3))
    net.add("other", mass(1.0, k=k))
    net.connect("wagon.flange", "stop.a", name="left")
    net.connect("stop.b", "other.flange", name="right")
    unit = instance(net.compose(), 2)
    happened, missing = landed(unit, 0.01, 40)
    off = abs(float(happened[0].lost.sum()) * 3 - 1)  # m1 m2/(2 (m1 + m2)) v^2 = 1/3 J
    back = float(unit.x[[n for v in unit.model.declaration.states for n in v.names()].index("wagon.v")])
    return StressOutcome(f"loss {off:.1e} off its formula, thrown back with {-back:.6f} m/s; energy {missing:.1e} H0",
                   off < 1e-12 and isclose(back, -2 / 3, rel_tol=1e-5) and missing < 1e-12)  # fmt: skip


def mass_ratio(m: float) -> StressOutcome:
    """The first wagon of `hard_stop` meets one of m kg."""
    from phfmu.components.library import build

    declaration = build("hard_stop").declaration().with_starts({"other.m": m})
    happened, missing = landed(instance(declaration, 6), 0.01, 20)
    lost, wanted = float(happened[0].lost.sum()), 2 * m / (2 * (2 + m)) * 100 * (0.15**2 - 0.05**2)
    off = abs(lost / wanted - 1)
    return StressOutcome(f"loss {off:.1e} off its formula; energy {missing:.1e} H0", off < 1e-8 and missing < 1e-12)


def at_step_end(parts: float) -> StressOutcome:
    """The first impact after this many steps: at the end of one, or at a part of the first."""
    happened, _ = landed(instance(ball(0.5), 2), FALL / parts, max(1, round(parts)))
    soon = [h for h in happened if h.t < 1.5 * FALL]
    off = late(soon, [FALL])
    return StressOutcome(f"{counted(len(soon), 'impact')}, {off:.1e} s off", off < 1e-14)


def many(n: int) -> StressOutcome:
    """An elastic ball, one bounce a step or two, at all places of a step."""
    h = 2 * FALL * 0.99
    happened, missing = landed(instance(ball(1.0), 2), h, round(2 * n * FALL / h) + 1)
    times = [FALL * (2 * i + 1) for i in range(len(happened))]
    off = late(happened, times) / times[-1]
    return StressOutcome(f"{len(happened)} events, times {off:.1e} of the last off; energy {missing:.1e} H0",
                   n <= len(happened) <= n + 1 and off < 1e-10 and missing < 1e-9)  # fmt: skip


CASES = (
    StressCase("events", "a turn 1e-6 beyond a guard, order 4", "2 events, energy <= 1e-14 H0", lambda: touch(1e-6, 4)),
    StressCase(
        "events", "a turn 1e-6 before a guard, order 6", "no event, energy <= 1e-14 H0", lambda: touch(-1e-6, 6)
    ),
    StressCase("events", "a bar that falls flat on both ends", "one event, loss to 1e-12", together),
    StressCase("events", "a ball comes to rest (Zeno)", "within 1e-6 s before the last bounce, nothing left", rests),
    StressCase("events", "bounces without end and without `rest`", "refused with the event and the remedy", endless),
    StressCase("events", "a relay that switches 3 times a step", "all events, times to 1e-11 s", busy),
    StressCase("events", "a relay that chatters: hysteresis 1e-6 rad/s", "refused with its name", chatter),
    StressCase(
        "events", "poles to an isolated star point open", "one, then two as one event; no current, no loss", neutral
    ),
    StressCase(
        "events",
        "contact with a body on a spring of 1e10 N/m, h = 0.01 s",
        "loss to 1e-12, thrown back, energy <= 1e-12 H0",
        lambda: stiff(1e10),
    ),
    StressCase("events", "impact of 2 kg on 1e-6 kg", "loss to 1e-8, energy <= 1e-12 H0", lambda: mass_ratio(1e-6)),
    StressCase("events", "impact of 2 kg on 1e6 kg", "loss to 1e-8, energy <= 1e-12 H0", lambda: mass_ratio(1e6)),
    StressCase("events", "an impact at the end of step 8", "happens once, to 1e-14 s", lambda: at_step_end(8.0)),
    StressCase("events", "an impact at 0.3 of the first step", "happens once, to 1e-14 s", lambda: at_step_end(0.3)),
    StressCase("events", "an impact at 1e-4 of the first step", "happens once, to 1e-14 s", lambda: at_step_end(1e-4)),
    StressCase(
        "events", "1e4 impacts", "none lost or doubled, times to 1e-10, energy <= 1e-9 H0", lambda: many(10_000)
    ),
    StressCase(
        "events",
        "1e5 impacts",
        "none lost or doubled, times to 1e-10, energy <= 1e-9 H0",
        lambda: many(100_000),
        long=True,
    ),
)
