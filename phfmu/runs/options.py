"""Options of a run: everything that `run` is told beside the stepper, checked in one place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

if TYPE_CHECKING:
    from phfmu.network.scene import Event
    from phfmu.runs.checkpoints import Checkpoints

#: most rows within a step, which are in memory together
DENSEST = 10_000

#: takes (times, values, whether each row lies within a step)
Keep = Callable[[NDArray[Any], NDArray[Any], NDArray[Any]], None]


@dataclass(frozen=True, kw_only=True)
class Options:
    """A run from `t0` to `stop` in communication steps of size `step`, all in s.

    events:  values that parameters and free inputs take; the grid of steps starts anew at each
    rtol:  steps are as long as |error| <= rtol |x| + atol nominal allows in each of them (atol: as rtol); then `step` is the
        first trial, steps are within [min_step, max_step], multiples of `landing` after t0 and each event are landed on
    energy_rtol:  in a step every junction of coupled members makes and hides at most this part of the energy that passes
        through it, and of atol [J] (default 0), within [min_step, max_step]; see `energy_steps.py`
    ecco:  the same by the rule of ECCO, for couplings that take each step once
    restart:  damping steps (Radau IIA) after each event
    signals:  the columns of the rows, by name or pattern (`gen.*`); none: all
    every:  rows this far apart only: an integer counts rows, any other number is a time in s; first and last row stay
    dense:  rows within each step, interpolated (see `dense.py`)
    project:  move an inconsistent start onto its constraints (booked as the event `reprojection`) instead of refusing it
    kept:  states that the projection leaves as they are
    audited:  whether a ledger is kept and judged
    audit_rtol:  allowed residual of the ledger, relative to the energies in play
    sink:  an audit sink (AuditWriter) that gets every ledger row as it is made
    hash_states:  the sink gets hashes of the states each so many steps, 0 never (see `state_hashes.py`)
    columns:  called with names, units, kinds and labels of the rows' columns, before the first row
    keep:  receives (time, values, whether a row lies within a step) blocks instead of collecting them; also those
        accepted before a failure
    happened:  called with time and message of each state event as it is booked
    checkpoints:  keeps where the run is between blocks, and where one that was ended goes on; see `checkpoints.py`
    progress:  called with the time after each block; a KeyboardInterrupt from it ends the run there
    Errors: ValueError for options that are out of range or do not go together.
    """

    stop: float
    step: float
    t0: float = 0.0
    events: Sequence[Event] = ()
    rtol: float | None = None
    energy_rtol: float | None = None
    ecco: float | None = None
    atol: float | None = None
    min_step: float = 0.0
    max_step: float = inf
    landing: float = inf
    restart: int = 0
    signals: Sequence[str] = ()
    every: int | float | None = None
    dense: int | None = None
    project: bool = False
    kept: Sequence[str] = ()
    audited: bool = True
    audit_rtol: float = 1e-11
    sink: Any = None
    hash_states: int = 0
    columns: Callable[[Sequence[str], Sequence[str], Sequence[str], Sequence[str]], None] | None = None
    keep: Keep | None = None
    happened: Callable[[float, str], None] | None = None
    progress: Callable[[float], None] | None = None
    checkpoints: Checkpoints | None = None

    @property
    def adaptive(self) -> bool:
        """Whether the step changes by itself."""
        return self.rtol is not None or self.by_energy

    @property
    def by_energy(self) -> bool:
        """Whether the step follows the energy at junctions."""
        return self.ecco is not None or self.energy_rtol is not None

    def __post_init__(self) -> None:
        _times(self)
        _tolerances(self)
        for e in self.events:
            if not isfinite(e.t) or not isfinite(e.value):
                raise ValueError(f"event {e.name} = {e.value} at t = {e.t} s: time and value must be finite")
        if self.restart < 0:
            raise ValueError(f"--restart {self.restart}: expected a number of steps from 0")
        if self.dense is not None and not 1 <= self.dense <= DENSEST:
            raise ValueError(
                f"--dense {self.dense}: expected a number of rows per step from 1 to {DENSEST}; for more take a shorter step"
            )
        if self.every is not None and not (isfinite(self.every) and self.every > 0):
            raise ValueError(f"--every {self.every:g}: expected a number of rows from 1, or a time in s above 0")
        if self.kept and not self.project:
            raise ValueError(f"--keep {self.kept[0]} says what a projection leaves alone; add --project")
        if self.sink is not None and not self.audited:
            raise ValueError("an audit file needs a ledger: leave out --audit none")
        if self.hash_states < 0:
            raise ValueError(f"--hash-states {self.hash_states}: expected a number of steps from 1")
        ledger_tolerance(self.audit_rtol, "--audit-rtol")


def _times(o: Options) -> None:
    if not (isfinite(o.step) and o.step > 0):
        raise ValueError(f"--step {o.step} s must be positive and finite")
    if not (isfinite(o.stop) and o.stop > o.t0):
        raise ValueError(f"--stop {o.stop} s must be finite and after the start {o.t0} s")
    if o.stop - o.step == o.stop:
        raise ValueError(
            f"--step {o.step} s is lost in the rounding of times near --stop {o.stop} s; take a longer one"
        )


def _tolerances(o: Options) -> None:
    if o.energy_rtol is not None:
        others = [
            n
            for n, given in (("--rtol", o.rtol), ("--ecco", o.ecco), ("--restart", o.restart or None))
            if given is not None
        ]
        if others:
            raise ValueError(f"--energy-rtol sizes steps by the energy at junctions; leave out {', '.join(others)}")
        if not 0 < o.energy_rtol < 1:
            raise ValueError(f"--energy-rtol {o.energy_rtol}: expected a number between 0 and 1, e.g. 1e-5")
        if o.atol is not None and not 0 <= o.atol < inf:
            raise ValueError(f"--atol {o.atol}: with --energy-rtol expected an energy in J from 0, e.g. 1e-5")
    elif o.ecco is not None:
        if o.rtol is not None or o.atol is not None or o.restart:
            raise ValueError("--ecco sizes steps by the energy of junctions; leave out --rtol, --atol and --restart")
        if not 0 < o.ecco < inf:
            raise ValueError(f"--ecco {o.ecco}: expected a positive tolerance, e.g. 1e-3")
    elif o.rtol is None:
        for name, given in (
            ("atol", o.atol is not None),
            ("min-step", o.min_step != 0),
            ("max-step", o.max_step != inf),
        ):
            if given:
                raise ValueError(f"--{name} is for adaptive steps; give --rtol too, or leave it out")
        return
    else:
        for name, value in (("--rtol", o.rtol), ("--atol", o.rtol if o.atol is None else o.atol)):
            if not 1e-13 <= value < 1:
                raise ValueError(f"{name} {value}: expected a number from 1e-13 to below 1, e.g. 1e-6")
    if not 0 <= o.min_step <= o.max_step or not o.max_step > 0:
        raise ValueError(f"--min-step {o.min_step} s and --max-step {o.max_step} s: expected 0 <= min <= max")


def ledger_tolerance(rtol: float, option: str) -> float:
    """A tolerance of the ledger, checked."""
    if not 0 <= rtol < inf:
        raise ValueError(f"{option} {rtol}: expected a number from 0, e.g. 1e-11")
    return rtol
