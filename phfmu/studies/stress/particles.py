"""Four particles with bars and stiff springs: stiffness, masses, speeds, step sizes, redundant and inconsistent bars."""

from __future__ import annotations

from typing import Any

import numpy as np

from phfmu.studies.stress.case import StressCase, StressOutcome, refused
from phfmu.studies.stress.drive import effort, instance, record
from phfmu.words import counted

H = 0.01
TARGET = "four_particle"


def four(**starts: float) -> Any:
    """The four particles with `name_i` for `name[i]`."""
    from phfmu.components.mechanical.four_particle import four_particle

    entry = {k: k.replace("_", "[") + "]" if "_" in k else k for k in starts}
    return four_particle().with_starts({entry[k]: v for k, v in starts.items()})


def stiffness(k: float, bound: float) -> StressOutcome:
    """300 steps without damping; energy, constraints, and the distance to a spring 100 times as stiff."""
    r, stiffer = (record(instance(four(k24=x, eta0=0.0)), H, 300) for x in (k, 100.0 * k))
    moved = float(np.abs(r.x[-1, 9:12] - stiffer.x[-1, 9:12]).max())
    text = f"{effort(r)}; energy {r.drift:.1e} H0, g {r.position:.1e} m2; q4(3 s) {moved:.1e} m from 100 k"
    return StressOutcome(text, r.drift <= bound and r.position <= 1e-12)


def mass(m: float) -> StressOutcome:
    """Particle 1 with mass m between a bar and a spring, 300 steps without damping."""
    r = record(instance(four(m_1=m, eta0=0.0)), H, 300)
    text = f"{effort(r)}; energy {r.drift:.1e} H0, g {r.position:.1e} m2"
    return StressOutcome(text, r.drift <= 1e-9 and r.position <= 1e-12)


def mass_limit() -> StressOutcome:
    """The motion tends to a limit as the mass vanishes: 1e-13 kg is as near to it as 1e-15 kg."""
    one, two = (record(instance(four(m_1=m, eta0=0.0)), H, 300) for m in (1e-13, 1e-15))
    q = float(np.abs(one.x[:, :12] - two.x[:, :12]).max())
    return StressOutcome(f"positions {q:.1e} m apart over 3 s; {effort(two)}", q <= 1e-8)


def limit(m: float) -> StressOutcome:
    """The error against the exact motion of the limit has order 2."""
    from phfmu.studies.stress.massless import motion

    exact, errors = motion(H * np.arange(1.0, 201.0)), []
    for parts in (1, 2, 4):
        r = record(instance(four(m_1=m, eta0=0.0)), H / parts, 200 * parts)
        errors.append(float(np.abs(r.x[parts - 1 :: parts, :12] - exact).max()))
    falls = [a / b for a, b in zip(errors, errors[1:], strict=False)]
    text = f"error {errors[0]:.1e} m over 2 s, falls {falls[0]:.2f} and {falls[1]:.2f} times with h halved"
    return StressOutcome(text, all(3.5 <= f <= 4.5 for f in falls))


def no_mass() -> StressOutcome:
    """Particle 1 without mass: its velocity follows from the constraint."""
    from phfmu import DeclarationError, StepFailure

    try:
        none, small = (record(instance(four(m_1=m, eta0=0.0)), H, 300) for m in (0.0, 1e-15))
    except (DeclarationError, StepFailure, ValueError) as error:
        return StressOutcome(f"refused: {error}", None)
    q = float(np.abs(none.x[:, :12] - small.x[:, :12]).max())
    return StressOutcome(f"positions {q:.1e} m from those of 1e-15 kg, energy {none.drift:.1e} H0", q <= 1e-8)


def barred(*lengths: float | None) -> Any:
    """Two particles on a swinging bar, given once per length."""
    from phfmu.components.mechanical.multibody import Multibody

    body = Multibody("barred")
    one = body.particle(1.0, (0, 0, 0), v=(0, 0, 0.3))
    two = body.particle(2.0, (1, 0, 0), v=(0, 1, -0.15))
    three = body.particle(0.5, (1, 1, 0))
    body.quartic_spring(two, three, 50.0)
    for length in lengths:
        body.bar(one, two, length)
    return body.build()


def duplicate(scheme: str) -> StressOutcome:
    """The same bar twice: rank-deficient constraints, minimum-norm multipliers."""
    single, double = (record(instance(barred(*[None] * n), scheme=scheme), H, 300) for n in (1, 2))
    moved = float(np.abs(single.x - double.x).max())
    sums = float(np.abs(double.a[:, :2].sum(axis=1) - single.a[:, 0]).max())
    split = float(np.abs(double.a[:, 0] - double.a[:, 1]).max())
    text = (
        f"q and v {moved:.1e} apart, multipliers add up to {sums:.1e} N/m and differ by {split:.1e}; {effort(double)}"
    )
    return StressOutcome(text, moved <= 1e-10 and sums <= 1e-8 and split <= 1e-5)


def contradicting() -> StressOutcome:
    """The bar again, 1e-6 m longer: no start meets both."""
    from phfmu.network.couplings.monolithic import Monolithic
    from phfmu.network.members.consistent import InconsistentState
    from phfmu.runs.loop import run
    from phfmu.runs.options import Options

    unit = instance(barred(None, 1.0 + 1e-6))
    found = refused(
        lambda: run(Monolithic(unit.model, unit), Options(stop=0.1, step=H)), InconsistentState, "lambda[2]"
    )
    return StressOutcome(f"{found.happened}; {unit.counts['steps']} steps", found.holds and unit.counts["steps"] == 0)


def off_manifold(project: bool) -> StressOutcome:
    """A start 1e-3 m off a bar's length: refused, or moved onto it."""
    from phfmu.network.couplings.monolithic import Monolithic
    from phfmu.network.members.consistent import InconsistentState
    from phfmu.runs.loop import run
    from phfmu.runs.options import Options

    unit = instance(four(q_4=1.001))
    stepper = Monolithic(unit.model, unit)
    if not project:
        return refused(lambda: run(stepper, Options(stop=0.1, step=H)), InconsistentState, "lambda[1]", "position")
    result = run(stepper, Options(stop=0.1, step=H, project=True))
    booked, worst = result.ledger.summary().events.get("reprojection", 0), max(result.worst.values())
    assert result.projection is not None
    moved = float(np.abs(result.projection.x[:12] - unit.model.x0[:12]).max())
    return StressOutcome(
        f"{counted(booked, 'event')} booked, coordinates moved by up to {moved:.1e} m; worst g {worst:.1e}",
        booked == 1 and moved <= 1e-3 and worst <= 1e-12,
    )


def large(h: float) -> StressOutcome:
    """Steps far beyond the fastest period, with damping: energy must fall in every one."""
    r = record(instance(four()), h, max(20, round(10.0 / h)))
    text = f"{effort(r)}; largest rise {max(r.rise, 0.0):.1e} H0, balance {r.balance:.1e}"
    return StressOutcome(text, r.finite and r.rise <= 1e-12 and r.balance <= 1e-10)


def fast(factor: float) -> StressOutcome:
    """Start velocity times factor at h = 0.01 s; 100 steps, or an error that names the step."""
    from phfmu import StepFailure

    unit = instance(four(v_12=factor * 20.0 / 17.0))
    try:
        r = record(unit, H, 100)
    except StepFailure as failure:
        return StressOutcome(f"typed error: {failure}", factor > 100)
    turn = factor * 20.0 / 17.0 * H
    text = f"{turn:.2g} rad a step; {effort(r)}; balance {r.balance:.1e}"
    return StressOutcome(text, r.finite and r.balance <= 1e-11)


def at_rest() -> StressOutcome:
    """Nothing moves: exact zeros; the second sweep finds that the first changed nothing."""
    unit = instance(four(v_12=0.0))
    x0 = unit.x
    r = record(unit, H, 10_000)
    text = f"largest change {np.abs(r.x - x0).max():.1g} in 10 000 steps, {effort(r)}"
    return StressOutcome(text, bool((r.x == x0).all()) and r.sweeps + r.iterations <= 2.001)


def million() -> StressOutcome:
    """10 000 s at h = 0.01 s without damping."""
    from time import process_time

    unit, energy, position, seconds = instance(four(eta0=0.0)), 0.0, 0.0, process_time()
    H0 = float(unit.signals()["H"].sum())
    for block in range(100):
        r = record(unit, H, 10_000, t0=block * 10_000 * H)
        energy, position = max(energy, float(np.abs(r.H.sum(axis=1) - H0).max())), max(position, r.position)
    text = f"energy {energy / H0:.1e} H0, g {position:.1e} m2, {process_time() - seconds:.0f} s CPU with all signals recorded"
    return StressOutcome(text, energy <= 1e-9 * H0 and position <= 1e-12)


ENERGY = "energy <= {} H0, g <= 1e-12"
CASES = (
    *(StressCase(TARGET, f"spring of {k:.0e} N/m3, h = 0.01 s", ENERGY.format("1e-9"), lambda k=k: stiffness(k, 1e-9))
      for k in (1e6, 1e8, 1e10)),
    StressCase(TARGET, "spring of 1e12 N/m3, h = 0.01 s", ENERGY.format("1e-6"), lambda: stiffness(1e12, 1e-6)),
    *(StressCase(TARGET, f"particle of {m:.0e} kg", ENERGY.format("1e-9"),
                 lambda m=m: mass(m)) for m in (1e-3, 1e-6, 1e-9, 1e-12)),
    StressCase(TARGET, "particle of 1e-13 kg as one of 1e-15 kg", "positions within 1e-8", mass_limit),
    StressCase(TARGET, "particle of 1e-15 kg, against the motion without its mass", "error falls 3.5 to 4.5 times with h halved",
               lambda: limit(1e-15)),
    StressCase(TARGET, "particle without mass as one of 1e-15 kg", "positions within 1e-8", no_mass),
    *(StressCase(TARGET, f"the same bar twice, {s}", "q, v within 1e-10; multipliers equal to 1e-5 N/m", lambda s=s: duplicate(s))
      for s in ("two-level", "semi-explicit")),
    StressCase(TARGET, "the bar again, 1e-6 m longer", "refused before a step, row named", contradicting),
    StressCase(TARGET, "start 1e-3 m off a bar, refused", "error names row and residual", lambda: off_manifold(False)),
    StressCase(TARGET, "start 1e-3 m off a bar, projected", "energy booked, moved <= 1e-3 m, g <= 1e-12",
               lambda: off_manifold(True)),
    *(StressCase(TARGET, f"h = {h:g} s, damped", "energy never rises, balance <= 1e-10", lambda h=h: large(h))
      for h in (0.4, 0.5, 1.0, 2.0, 20.0)),
    *(StressCase(TARGET, f"velocities x{f:g} at h = 0.01 s", "balance <= 1e-11" + (" or a typed error" if f > 100 else ""),
                 lambda f=f: fast(f)) for f in (10.0, 100.0, 1000.0, 10000.0)),
    StressCase(TARGET, "rest, 10 000 steps", "state unchanged, at most 2 sweeps a step", at_rest),
    StressCase(TARGET, "1e6 steps, undamped", "energy <= 1e-9 H0, g <= 1e-12", million, long=True),
)  # fmt: skip
