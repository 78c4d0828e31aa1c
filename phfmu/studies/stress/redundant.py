"""Redundant constraints: of rows that depend on each other as many rest as are too many, and nothing is lost by it."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu.studies.stress.case import StressCase, StressOutcome
from phfmu.studies.stress.drive import StepRecord, effort, instance, record

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE

NAMES = {
    "frame": "a rigid frame",
    "doubled": "doubled bars",
    "hinge": "a hinge on two pins",
    "bricard": "Bricard's linkage",
}


def declaration(name: str) -> PHDAE:
    """One of the mechanisms."""
    from phfmu.studies.stress import mechanisms

    return mechanisms.bricard()[0] if name == "bricard" else getattr(mechanisms, name)()


@cache
def stepped(name: str, order: int) -> Any:
    """Its instance, made once."""
    return instance(declaration(name), order=order)


def told(name: str, r: StepRecord) -> tuple[str, float]:
    """Rows and rank, what constraints and energy missed, and the latter [J]."""
    from phfmu import constraint_rank

    rank, energy = constraint_rank(declaration(name)), float(np.ptp(r.H.sum(axis=1)))
    text = f"{rank.rows} rows of rank {rank.rank}; g {r.position:.1e}, Dg v {r.velocity:.1e}, energy {energy:.1e} J; {effort(r)}"
    return text, energy


def moves(name: str, h: float, order: int, stop: float, most: float) -> StressOutcome:
    """Constraints to rounding, the energy to `most` [J], no step halved."""
    unit = stepped(name, order)
    unit.reset()
    r = record(unit, h, round(stop / h))
    text, energy = told(name, r)
    return StressOutcome(
        text, r.position <= 1e-14 and r.velocity <= 1e-13 and energy <= most and "substep" not in r.solved
    )


def accurate(h: float, order: int, most: float) -> StressOutcome:
    """Bricard's hinges after 10 s beside an independent solution."""
    from phfmu.studies.stress.mechanisms import bricard_reference

    unit = stepped("bricard", order)
    unit.reset()
    r = record(unit, h, round(10.0 / h))
    error = float(np.abs(r.x[-1, :12] - bricard_reference(10.0)).max())
    text, _ = told("bricard", r)
    return StressOutcome(f"position error {error:.1e} m; {text}", error <= most)


def there_and_back(n: int) -> StressOutcome:
    """n steps of Bricard's linkage and the same steps back."""
    unit = stepped("bricard", 6)
    unit.reset()
    start = unit.x
    unit.run(0.0, 0.01, n)
    far = float(np.abs(unit.x - start).max())
    unit.run(0.01 * n, -0.01, n)
    back = float(np.abs(unit.x - start).max())
    return StressOutcome(f"moved by {far:.1e}, came back to {back:.1e}", back <= 1e-13, tested=far > 1e-3)


def criterion(most: float) -> str:
    return f"g <= 1e-14, Dg v <= 1e-13, energy to {most:.0e} J, unhalved"


# the chord leaves some 1e-17 of the energies in play in a step, which adds up: 10 times as much in 10 times as many steps
RUNS = ((0.01, 2e-12), (0.001, 2e-11))
CASES = (
    *(StressCase(name, f"{NAMES[name]}, 2 s at h = {h} s, order {order}", criterion(most),
                 lambda name=name, h=h, order=order, most=most: moves(name, h, order, 2.0, most))
      for name in ("frame", "doubled", "hinge") for order in (2, 6) for h, most in RUNS),
    *(StressCase("bricard", f"Bricard's linkage (benchmark A03 of the IFToMM library), 4 s at h = 0.01 s, order {order}",
                 criterion(1e-13), lambda order=order: moves("bricard", 0.01, order, 4.0, 1e-13)) for order in (2, 6)),
    *(StressCase("bricard", f"10 s at h = {h} s, order {order}", f"error <= {most:.0e} m",
                 lambda h=h, order=order, most=most: accurate(h, order, most))
      for h, order, most in ((0.01, 2, 1e-3), (0.025, 6, 1e-10))),
    StressCase("bricard", "150 steps of 0.01 s and back, order 6", "back to 1e-13", lambda: there_and_back(150)),
)  # fmt: skip
