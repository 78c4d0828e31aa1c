"""Networks of masses and springs: stiff couplings, rigid links, double wells, rings, multirate, wrong connections."""

from __future__ import annotations

from typing import Any

import numpy as np

from phfmu.studies.stress.case import StressCase, StressOutcome, refused
from phfmu.studies.stress.drive import effort, instance, record


def stiff_pair(k: float) -> Any:
    """Two masses of 1 kg to ground (100 N/m each), a spring of k N/m between."""
    from phfmu import Network
    from phfmu.components.mechanical.translational import mass, spring

    net = Network("stiff_pair")
    net.add("m1", mass(1.0, k=100.0, v=1.0))
    net.add("m2", mass(1.0, k=100.0, v=1.0))
    net.add("s", spring(k))
    net.connect("m1.flange", "s.a")
    net.connect("m2.flange", "s.b")
    return net


def stiff(k: float) -> StressOutcome:
    """Members stepped apart and joined by Newton: the pair moves together as one mass."""
    from dataclasses import replace

    from phfmu.network.couplings.coupled import Coupled
    from phfmu.network.members.engine_member import EngineMember
    from phfmu.runs.loop import run
    from phfmu.runs.options import Options

    net = stiff_pair(k)
    units = {n: instance(replace(d, name=n)) for n, d in net.members.items()}
    result = run(Coupled(net, [EngineMember(n, u.model, u) for n, u in units.items()]), Options(stop=1.0, step=0.01))
    worst = max(c.worst_relative for c in result.ledger.summary().components)
    exact = 0.1 * np.sin(10.0 * result.time)
    error = float(np.abs(result.column("m1.q") - exact).max())
    text = f"{result.iterations / result.steps:.1f} iterations a step, ledger {worst:.1e}, error {error:.1e} m"
    return StressOutcome(text, worst <= 1e-11 and error <= 2e-3)


def period(ratio: float) -> StressOutcome:
    """The oscillator at a step of `ratio` times its fastest period (1/3 s)."""
    from phfmu.components.scenes.mechanical.oscillator import oscillator

    r = record(instance(oscillator().declaration()), ratio / 3.0, 1000)
    accurate = "accurate" if ratio < 0.05 else "no accuracy at this step"
    return StressOutcome(
        f"balance {r.balance:.1e}, energy {r.drift:.1e} H0 ({accurate}); {effort(r)}",
        r.balance <= 1e-11 and r.drift <= 1e-10,
    )


def well(h: float) -> StressOutcome:
    """Double well V = (q^2 - 1)^2 / 4 with 1 kg near its top: above h = 2 s a step has several solutions."""
    from phfmu import PHDAE, StepFailure, energy, skew, state
    from phfmu.outcome.status import remedy

    q, v = state("q", unit="m", start=0.01), state("v", unit="m/s")
    double = PHDAE("double_well", states=(q, v), structure=(skew(q, v, 1.0),),
                   energies=(energy((q.sx**2 - 1) ** 2 / 4), energy(0.5 * v.sx**2)))  # fmt: skip
    try:
        r = record(instance(double), h, 200)
    except StepFailure as failure:
        return StressOutcome(f"typed error: {failure}", bool(remedy(failure)))
    return StressOutcome(
        f"balance {r.balance:.1e}, energy {r.drift:.1e} H0; {effort(r)}", r.balance <= 1e-11 and r.drift <= 1e-9
    )


def rigid_link(v1: float, v2: float) -> Any:
    """Masses of 1 and 2 kg, joined rigidly."""
    from phfmu import Network
    from phfmu.components.mechanical.translational import mass

    net = Network("rigid_link")
    net.add("m1", mass(1.0, v=v1))
    net.add("m2", mass(2.0, v=v2))
    net.junction("link", ["m1.flange", "m2.flange"])
    return net.compose()


def rigid(project: bool) -> StressOutcome:
    """Velocities 1 and 0 m/s at a rigid link: refused, or an inelastic impact that loses 1/3 J."""
    from phfmu.discretise.start import project_start
    from phfmu.network.couplings.monolithic import Monolithic
    from phfmu.network.members.consistent import InconsistentState
    from phfmu.runs.loop import run
    from phfmu.runs.options import Options

    unit = instance(rigid_link(1.0, 0.0))
    if not project:
        return refused(
            lambda: run(Monolithic(unit.model, unit), Options(stop=0.1, step=0.01)), InconsistentState, "link"
        )
    lost = project_start(unit.model).energy
    return StressOutcome(f"energy changed by {lost:.15g} J", abs(lost + 1.0 / 3.0) <= 1e-12)


def at_rest() -> StressOutcome:
    """All zeros for 10 000 steps."""
    net = stiff_pair(1e4)
    still = net.compose().with_starts({"m1.v": 0.0, "m2.v": 0.0})
    r = record(instance(still), 0.01, 10_000)
    return StressOutcome(
        f"largest value {np.abs(r.x).max():g}; {effort(r)}", bool((r.x == 0.0).all()) and r.iterations <= 2.0
    )


def light(m: float) -> StressOutcome:
    """A mass m on a spring of 100 N/m, driven: the force-velocity gain tends to 2/(h k)."""
    from phfmu.components.mechanical.translational import mass

    unit, h = instance(mass(m, k=100.0)), 0.01
    unit.set_input([1.0])
    unit.do_step(0.0, h)
    gain, limit = float(unit.output()[0]), h / 2.0 / (m + 100.0 * h**2 / 4.0)
    return StressOutcome(f"gain {gain:.6g} m/s/N, exact {limit:.6g}", abs(gain - limit) <= 1e-12 * limit)


def nothing_moves() -> StressOutcome:
    """No mass and no spring: an ideal force at a free end determines nothing."""
    from phfmu import StepFailure
    from phfmu.components.mechanical.translational import mass

    def attempt() -> None:
        unit = instance(mass(0.0))
        unit.set_input([1.0])
        unit.do_step(0.0, 0.01)

    return refused(attempt, StepFailure, "singular", "balance of v")


def ring(n: int) -> StressOutcome:
    """n masses in a closed ring of n springs, one of them struck."""
    from phfmu import Network
    from phfmu.components.mechanical.translational import mass, spring

    net = Network("ring")
    for i in range(n):
        net.add(f"m{i}", mass(1.0, v=float(i == 0)))
    for i in range(n):
        net.add(f"s{i}", spring(1e4))
    for i in range(n):
        net.junction(f"j{i}", [f"m{i}.flange", f"s{i}.a", f"s{i - 1 if i else n - 1}.b"])
    r = record(instance(net.compose()), 0.001, 200)
    momentum = float(np.abs(r.x[:, 1 : 2 * n : 2].sum(axis=1) - 1.0).max())
    text = f"balance {r.balance:.1e}, energy {r.drift:.1e} H0, momentum {momentum:.1e}; {effort(r)}"
    return StressOutcome(text, r.balance <= 1e-11 and r.drift <= 1e-11 and momentum <= 1e-11)


def star(n: int) -> StressOutcome:
    """A mass at a junction of n ports, all others of springs: together one spring, of which the midpoint rule is known."""
    from phfmu import Network
    from phfmu.components.mechanical.translational import mass, spring

    net, m, k, h, steps = Network("star"), 2.0, 40.0, 0.01, 100
    net.add("hub", mass(m, v=1.0))
    springs = [f"s{i}" for i in range(n - 1)]
    for name in springs:
        net.add(name, spring(k / len(springs)))
    net.junction("centre", ["hub.flange", *(f"{name}.a" for name in springs)])
    r = record(instance(net.compose()), h, steps)
    turn = 2 * np.arctan(np.sqrt(k / m) * h / 2)
    off = float(np.abs(r.x[:, 1] - np.cos(turn * np.arange(1, steps + 1))).max())
    text = f"balance {r.balance:.1e}, energy {r.drift:.1e} H0, speed {off:.1e} m/s from the midpoint rule by hand; {effort(r)}"
    return StressOutcome(text, r.balance <= 1e-11 and r.drift <= 1e-11 and off <= 1e-11)


def apart() -> StressOutcome:
    """Two parts that share nothing, in one network: each as alone."""
    from phfmu import Network
    from phfmu.components.mechanical.translational import mass

    net = Network("apart")
    net.add("one", mass(1.0, k=4.0, q=1.0))
    net.add("two", mass(2.0, k=9.0, q=-1.0))
    both = record(instance(net.compose()), 0.01, 500)
    alone = [record(instance(mass(m, k=k, q=q)), 0.01, 500) for m, k, q in ((1.0, 4.0, 1.0), (2.0, 9.0, -1.0))]
    off = float(np.abs(both.x - np.hstack([a.x for a in alone])).max())
    return StressOutcome(f"states {off:.1e} from those of each alone", off <= 1e-13)


def wrong(what: str) -> StressOutcome:
    """Connections that cannot be: refused when they are made."""
    from phfmu import Network
    from phfmu.components.electrical import rl_line
    from phfmu.components.mechanical.translational import mass, spring

    net = Network("wrong")
    net.add("m", mass(1.0))
    net.add("s", spring(1.0))
    net.add("line", rl_line(1.0, 1.0))
    net.add("m2", mass(1.0))
    calls = {
        "sign": (lambda: net.connect("m.flange", "s.a", signs=(1, 1)), ("create power",)),
        "domain": (lambda: net.connect("m.flange", "line.a"), ("m.flange", "line.a")),
        "self": (lambda: net.connect("s.a", "s.a"), ("s.a", "itself")),
        "twice": (
            lambda: [net.junction("a", ["m.flange", "m2.flange"]), net.junction("b", ["m.flange", "m2.flange"])],
            ("joined",),
        ),
    }
    call, words = calls[what]
    return refused(call, ValueError, *words)


CASES = (
    *(StressCase("stiff_pair", f"coupling spring of {k:.0e} N/m, members apart, h = 0.01 s", "ledger <= 1e-11, error <= 2e-3 m",
                 lambda k=k: stiff(k)) for k in (1e4, 1e8, 1e10)),
    *(StressCase("oscillator", f"h = {x:g} of the fastest period", "balance <= 1e-11, energy <= 1e-10 H0", lambda x=x: period(x))
      for x in (1e-6, 1e-3, 1.0, 1e3)),
    *(StressCase("double_well", f"h = {h:g} s (unique below 2 s)", "balance <= 1e-11, or an error with the remedy",
                 lambda h=h: well(h))
      for h in (0.67, 1.9, 2.1, 5.0)),
    StressCase("rigid_link", "velocities 1 and 0 m/s, refused", "error names the link", lambda: rigid(False)),
    StressCase("rigid_link", "velocities 1 and 0 m/s, projected", "loses 1/3 J", lambda: rigid(True)),
    StressCase("stiff_pair", "rest, 10 000 steps", "exact zeros", at_rest),
    *(StressCase("mass", f"{m:g} kg on a spring, gain of a step", "h/2 / (m + k h2/4) to 1e-12", lambda m=m: light(m))
      for m in (1.0, 1e-6, 1e-12)),
    StressCase("mass", "no mass, no spring, no damper", "refused with a reason", nothing_moves),
    StressCase("star", "a junction of 1000 ports", "balance, energy, midpoint rule <= 1e-11", lambda: star(1000), long=True),
    StressCase("ring", "closed ring of 100 masses and springs", "balance, energy, momentum <= 1e-11", lambda: ring(100)),
    StressCase("apart", "two parts that share nothing", "as each alone, 1e-13", apart),
    *(StressCase("wrong", label, "refused when made", lambda w=w: wrong(w)) for w, label in (
        ("sign", "u1 = +y2, u2 = +y1"), ("domain", "a mass on a power line"), ("self", "a port joined to itself"),
        ("twice", "the same rigid link twice"))),
)  # fmt: skip
