"""What to do about a step that was refused: remedies with the facts under which each is true, the first that fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from phfmu.engine.status import Status, StepFailure

#: the equations hold to this scaled residual while the unknowns still move by more than `MOVES` of their nominal size
HOLDS, MOVES = 1e-9, 1e-6


@dataclass(frozen=True)
class Remedy:
    """For outcomes of one kind: `holds` says of a failure whether the advice is true for it."""

    status: Status
    holds: Callable[[StepFailure], bool]
    text: str


def _always(_: StepFailure) -> bool:
    return True


def _instant(f: StepFailure) -> bool:
    return f.h == 0.0


def _longer_worked(f: StepFailure) -> bool:
    return 0.0 < f.asked < f.longest * (1 - 1e-9)


def _at_rounding(f: StepFailure) -> bool:
    return f.residual <= max(HOLDS, 10 * f.floor) and f.update > MOVES


def _stalls(f: StepFailure) -> bool:
    """The residuals of the last iterations do not shrink."""
    return len(f.history) > 2 and not f.history[-1] < 0.5 * f.history[-3]


REMEDIES = (
    Remedy(
        Status.NO_CONVERGENCE,
        _longer_worked,
        "steps of {longest:.3g} s were solved before this one of {asked:.3g} s, so a shorter one is no remedy: move events and "
        "input rows onto the grid of steps",
    ),
    Remedy(
        Status.NO_CONVERGENCE,
        _instant,
        "there is no solution near the values at this time: look at the start values, inputs and parameters of this equation",
    ),
    Remedy(
        Status.NO_CONVERGENCE,
        lambda f: f.joined and _stalls(f),
        "the residual has stopped shrinking: compose the network (--coupling monolithic), or compare the sizes of members that "
        "meet there",
    ),
    Remedy(
        Status.NO_CONVERGENCE,
        lambda f: f.joined,
        "the iteration still moves: take a smaller step, or compose the network (--coupling monolithic)",
    ),
    Remedy(
        Status.NO_CONVERGENCE,
        _at_rounding,
        "the equations hold while the unknowns still move, so something is hardly determined here (a singular configuration, "
        "nearly dependent constraints) and a smaller step is no remedy; a larger one may pass over it",
    ),
    Remedy(
        Status.NO_CONVERGENCE,
        _always,
        "substeps down to {h:.3g} s failed too, so a somewhat smaller step is no remedy: look at the inputs and the state near "
        "this time, which may run to a point without solution",
    ),
    Remedy(
        Status.SINGULAR,
        lambda f: f.joined,
        "nothing determines what is shared there (ideal sources joined, or members without inertia, compliance or resistance): "
        "put an element that stores or dissipates between them",
    ),
    Remedy(Status.SINGULAR, _always, "check that every unknown is determined by an equation (`phfmu check`)"),
    Remedy(
        Status.NOT_FINITE,
        _instant,
        "check start values, inputs and parameters; H and its gradient must be finite there",
    ),
    Remedy(
        Status.NOT_FINITE,
        lambda f: f.joined,
        "check inputs and parameters of the members, or take a smaller step if a state leaves the domain of H",
    ),
    Remedy(
        Status.NOT_FINITE,
        _always,
        "check inputs and parameters; substeps down to {h:.3g} s failed too, so the state itself leaves the domain of H here",
    ),
    Remedy(
        Status.LU_CAPACITY,
        _always,
        "discretise the model again, so that the memory is planned for its present structure",
    ),
    Remedy(Status.ABI, _always, "empty the cache folder (PHFMU_CACHE_DIR) and build again"),
    Remedy(
        Status.ARGUMENT,
        _always,
        "time and step must be finite, the parts at least 1, and node inputs need a Gauss scheme",
    ),
    Remedy(Status.VALUE, _always, "look for its source: inputs, parameters and states must be numbers"),
    Remedy(
        Status.NO_SENSITIVITY,
        _always,
        "take one internal step per communication step, or use finite differences",
    ),
)


def remedy(failure: StepFailure) -> str:
    """The first remedy that is true for the facts of a failure; "" if there is none."""
    for r in REMEDIES:
        if r.status is failure.status and r.holds(failure):
            return r.text.format(h=failure.h, asked=failure.asked, longest=failure.longest)
    return ""
