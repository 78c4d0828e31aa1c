"""Constraints that nearly depend on each other; what may not change a bit of a result: threads, jobs, the order of members."""

from __future__ import annotations

from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from phfmu.studies.stress.case import StressCase, StressOutcome
from phfmu.studies.stress.drive import instance
from phfmu.studies.stress.members.couplings import coupled, oscillator, run

H, STEPS = 0.01, 300
MOST = 1e-11


def plates(angle: float) -> Any:
    """1 kg held in the edge of two plates, along which a spring of 4 N/m pulls it; 1 N pulls it out of the edge.

    Where the plates are one plane it falls along them.
    """
    from phfmu import PHDAE, Holonomic, algebraic, energy, skew, state

    q, v = state("q", 3, unit="m", start=(0.0, 0.0, 1.0)), state("v", 3, unit="m/s")
    one, two = algebraic("one", unit="N"), algebraic("two", unit="N")
    return PHDAE(
        "plates", states=(q, v), algebraics=(one, two), structure=(skew(q, v, 1.0),),
        energies=(energy(ca.sumsqr(v.sx) / 2), energy(2.0 * q[2] ** 2), energy(-1.0 * q[0])),
        constraints=(Holonomic(one, q[1]), Holonomic(two, q[1] * np.cos(angle) + q[0] * np.sin(angle))),
    )  # fmt: skip


def between(angle: float, hard: bool) -> StressOutcome:
    """Held, or falling as by hand where one constraint rests.

    `hard`: or an error that names a row, or a ledger that does not close.
    """
    from phfmu import StepFailure, constraint_rank
    from phfmu.network.couplings.monolithic import Monolithic

    declaration = plates(angle)
    unit, rank = instance(declaration), constraint_rank(declaration).rank
    try:
        result = run(Monolithic(unit.model, unit), H * STEPS, H)
    except StepFailure as failure:
        told = f"rank {rank}; {failure.status.name.lower().replace('_', ' ')} at {failure.equation}"
        return StressOutcome(told, hard and ("one" in failure.equation or "two" in failure.equation))
    t = H * np.arange(STEPS + 1)
    x, z = (result.values[:, result.names.index(n)] for n in ("q[1]", "q[3]"))
    # midpoint rule by hand: turns by 2 atan(w h/2) a step, free fall is exact
    off = float(np.abs(z - np.cos(2 * np.arctan(H) * np.arange(STEPS + 1))).max())
    out = float(np.abs(x - (0.0 if rank == 2 else t**2 / 2)).max())
    closed = result.ledger.summary().closed
    told = "closed" if closed else "violated, exit code 4"
    text = (
        f"rank {rank}; {out:.1e} m from {'the edge' if rank == 2 else 'free fall'}, along it {off:.1e} m; ledger {told}"
    )
    return StressOutcome(text, off <= MOST and (out <= 1e-7 if closed else hard))


def bits(rows: list[Any]) -> tuple[bool, float]:
    """True if all are the same to the last bit, and their largest distance."""
    worst = max(float(np.abs(r - rows[0]).max()) for r in rows)
    return all(r.tobytes() == rows[0].tobytes() for r in rows), worst


def threads() -> StressOutcome:
    """Columns and ledger rows of members stepped by one thread, and by two."""
    found = []
    for n in (1, 2):
        steps = started(coupled(oscillator(), threads=n)).advance(0.0, H, STEPS)
        found.append(np.hstack([steps.signals, steps.stored, steps.supplied, steps.pairs]))
    same, worst = bits(found)
    return StressOutcome("the same bits" if same else f"{worst:.1e} apart", same, tested=found[0].std() > 0)


def started(stepper: Any) -> Any:
    stepper.check_start()
    stepper.prepare(0.0, H)
    return stepper


def jobs() -> StressOutcome:
    """A sweep by one, two and five threads."""
    from phfmu.components.mechanical.translational import mass
    from phfmu.runs.options import Options
    from phfmu.sweeps.design import Design
    from phfmu.sweeps.runs import sweep

    design = Design(("k",), np.linspace(1.0, 9.0, 40)[:, None])
    tables = [
        sweep(
            mass(1.0, k=1.0, q=1.0),
            design,
            ["last(v)", "max(energy.stored)"],
            options=Options(stop=2.0, step=H),
            jobs=n,
        )
        for n in (1, 2, 5)
    ]
    same = all(t.equals(tables[0]) for t in tables)
    return StressOutcome(
        "the same bits" if same else "they differ", same, tested=len(set(tables[0]["last(v)"].to_pylist())) == 40
    )


def turned() -> StressOutcome:
    """The members of a network in another order: their energies, by name."""
    from phfmu import Network

    net = oscillator()
    other = Network(net.name)
    for name in reversed(net.members):
        other.add(name, oscillator().members[name])
    for j in net.junctions:
        other.junction(j.name, [str(e) for e in j.ends], j.kind)
    found = []
    for n in (net, other):
        steps = started(coupled(n)).advance(0.0, H, STEPS)
        place = {name: i for i, name in enumerate(n.members)}
        found.append(steps.stored[:, [place[name] for name in net.members]])
    same, worst = bits(found)
    return StressOutcome("the same bits" if same else f"{worst:.1e} J apart", worst <= 1e-12, tested=found[0].std() > 0)


CASES = (
    *(StressCase("plates", f"two constraints at an angle of {a:g}", "held, or falling as by hand, to 1e-7 m",
                 partial(between, a, False)) for a in (1e-4, 1e-6, 1e-10, 0.0)),
    *(StressCase("plates", f"two constraints at an angle of {a:g}", "the same, or an error that names one, or exit code 4",
                 partial(between, a, True)) for a in (1e-7, 1e-8)),
    StressCase("same_bits", "members stepped by 1 and 2 threads", "the same bits", threads),
    StressCase("same_bits", "a sweep of 40 runs by 1, 2 and 5 jobs", "the same bits", jobs),
    StressCase("same_bits", "members of a network in another order", "energies within 1e-12 J", turned),
)  # fmt: skip
