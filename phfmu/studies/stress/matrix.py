"""The matrix: cases with systems of their own, and the step cases of a target."""

from __future__ import annotations

from phfmu.studies.stress import (
    events,
    iron,
    linkage,
    machine,
    near,
    particles,
    redundant,
    steps,
)
from phfmu.studies.stress.case import StressCase
from phfmu.studies.stress.members import coupled, couplings, crash, units

#: scenes and components whose steps are put to the test without a target
STEPPED = ("smib", "four_particle", "dc_motor")


def cases(target: str | None) -> list[StressCase]:
    """All cases, or those about one target: its steps, and the cases with its name."""
    from phfmu.target import require_known, scene

    own = [
        c
        for module in (particles, linkage, redundant, coupled, couplings, near, crash, units, machine, iron, events)
        for c in module.CASES
    ]
    if target is None:
        return [*own, *(c for name in STEPPED for c in steps.cases(name, scene(name)))]
    if any(c.target == target for c in own):
        mine = [c for c in own if c.target == target]
        try:
            return [*mine, *steps.cases(target, scene(target))]
        except KeyError:  # a system of the matrix that is not in the library
            return mine
    require_known(target, sorted({c.target for c in own}))
    return list(steps.cases(target, scene(target)))
