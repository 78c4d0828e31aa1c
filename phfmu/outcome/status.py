"""Outcomes of a step: one enumeration whose values are the messages, the exception that carries them, and what to do.

Remedies stand with the facts under which each is true; the first that fits is told.

Refused state events are failures with their guards.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from phfmu.outcome.limits import LIMITS


class Status(Enum):
    """Outcome of a solve; order and messages are those of `ph_status` in `runtime/phfmu.h`, then those of couplings."""

    OK = "step accepted"
    NO_CONVERGENCE = "Newton's method did not converge"
    SINGULAR = "the Newton matrix is singular: an equation is missing or redundant"
    NOT_FINITE = "a value is not finite"
    LU_CAPACITY = "the factors of the Newton matrix outgrew the reserved memory"
    ABI = "model tables and compiled runtime do not belong together"
    ARGUMENT = "an argument is out of range"
    VALUE = "a given value is not finite; it was not taken over"
    NO_SENSITIVITY = "the sensitivity needs a last step of which at most 16 internal steps were halved"
    EVENT = "a state event cannot happen"
    UNIT = "a unit of another tool refused a call"
    #: not one of `ph_status`: what a coupling of members finds
    GROWTH = "the energy of the members grows without bound"


def _ran_out(spent: int) -> bool:
    return spent >= LIMITS["MOST_ITERATIONS"]


def attempts(h: float, spent: int) -> str:
    """The attempts of an engine at a step whose last substep had the length h, in `spent` iterations; h = 0: at one instant."""
    if h == 0.0:
        return "two starts, line search"
    halved = f"substeps down to {h:.3g} s" if _ran_out(spent) else f"{2 ** int(LIMITS['DEPTH'])} substeps"
    return f"two starts, shorter steps, line search and {halved}"


class NoDerivative(ValueError):
    """A step or event at the time `t` [s] has no derivative, and `why`: its equations depend on each other, for example."""

    def __init__(self, t: float, why: str = ""):
        super().__init__(
            why or f"the step at t = {t:.9g} s has no derivative: its equations depend on each other there"
        )
        self.t = t


class StepFailure(RuntimeError):
    """A step that was refused; the instance is at its last accepted step.

    `component`: name of the model; `time`, `h`: start and length (s) of the refused step or substep, h = 0 if
    the values at one instant failed; `equation`: name of the row with the largest scaled residual `residual`, of
    which rounding alone leaves `floor`; `update`: last scaled change of the unknowns (1 = nominal); `iterations` of the
    last attempt, `spent` by all at this internal step; `tried`: what was attempted; `joined`: members were being joined,
    `put_off` those that stepped last, `history` the scaled residuals of that, `composable`: they are all declared, so that one
    model can be made of them, `signals`: it is what they exchange without power that does not agree.
    A master adds `unsteady`: which of its units do not repeat a step, and how.  A run adds `asked`, the step it asked for, and
    `longest`, the longest it had solved.  The remedy follows from these (`remedy`).
    """

    #: whether the component cannot be asked for anything any more, not even to go back
    final = False

    def __init__(
        self,
        status: Status,
        component: str,
        time: float,
        h: float,
        *,
        equation: str = "",
        residual: float = float("nan"),
        floor: float = 0.0,
        update: float = float("nan"),
        iterations: int = 0,
        spent: int = 0,
        tried: str = "",
        joined: bool = False,
        composable: bool = False,
        put_off: str = "",
        history: Sequence[float] = (),
        signals: bool = False,
    ) -> None:
        self.status = status
        self.component = component
        self.time = time
        self.h = h
        self.equation = equation
        self.residual = residual
        self.floor = floor
        self.update = update
        self.iterations = iterations
        self.spent = spent
        self.tried = tried
        self.joined, self.composable, self.history = joined, composable, tuple(history)
        self.put_off, self.signals = put_off, signals
        self.asked, self.longest, self.unsteady = 0.0, 0.0, ""
        #: what a run over many steps had recorded of the accepted ones
        self.recorded: dict[str, Any] = {}
        super().__init__()

    @property
    def ran_out(self) -> bool:
        """Whether the iterations of the step ended before the shortest substeps were tried."""
        return _ran_out(self.spent)

    def __str__(self) -> str:
        return self._text()

    def _text(self) -> str:
        """The failure with its numbers, and the remedy."""
        text = f"{self.component} at t = {self.time:.9g} s" + (f", h = {self.h:.3g} s" if self.h else "")
        text += f": {self.status.value}"
        if self.equation:
            text += f"; worst: {self.equation}"
        if self.residual == self.residual:
            text += f", scaled residual {self.residual:.3g}"
        if self.floor:
            text += f" (rounding floor {self.floor:.2g})"
        if self.update == self.update:
            text += f", last update {self.update:.3g}"
        if self.iterations:
            text += f", {self.iterations} iterations"
        if self.ran_out:
            text += f", {self.spent} with all attempts: no step may take more"
        if self.tried:
            text += f"; tried {self.tried}"
        advice = remedy(self)
        return text + (f". Next: {advice}." if advice else "")


class EndRequested(StepFailure):
    """A component asks to end the simulation, which is a regular end of a run.

    `time`, `h`: of the step in which it asked; `reached`: where it ends; `last`: the fields of `Steps` of the part from `time` to
    there, if it was taken; `back`: all components are at `time` again, from which that part can be taken; `words`: what it said.
    """

    def __init__(self, component: str, time: float, h: float, reached: float, words: Sequence[str] = ()):
        super().__init__(Status.UNIT, component, time, h)
        self.reached, self.words, self.last, self.back = reached, tuple(words), None, False

    last: Any

    def _text(self) -> str:
        said = f" ({' | '.join(self.words)})" if self.words else ""
        return f"{self.component} asks to end the simulation at t = {self.reached:.9g} s{said}"


#: the equations hold to this scaled residual while the unknowns still move by more than `MOVES` of their nominal size
HOLDS, MOVES = 1e-9, 1e-6


@dataclass(frozen=True)
class FailureRemedy:
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


#: where signals do not agree
UNITERATED = "take a smaller step, or --signals-held, so that signals are taken from the steps before"

REMEDIES = (
    FailureRemedy(
        Status.NO_CONVERGENCE,
        lambda f: bool(f.unsteady),
        "{unsteady}, so that no iteration converges: take --coupling gauss-seidel, which repeats no step, or ask its maker",
    ),
    FailureRemedy(
        Status.NO_CONVERGENCE,
        _longer_worked,
        "steps of {longest:.3g} s were solved before this one of {asked:.3g} s, so a shorter one is no remedy: move events and "
        "input rows onto the grid of steps",
    ),
    FailureRemedy(
        Status.NO_CONVERGENCE,
        _instant,
        "there is no solution near the values at this time: look at the start values, inputs and parameters of this equation",
    ),
    FailureRemedy(Status.NO_CONVERGENCE, lambda f: f.signals, UNITERATED),
    FailureRemedy(
        Status.NO_CONVERGENCE,
        lambda f: f.composable and _stalls(f),
        "the residual has stopped shrinking: compose the network (--coupling monolithic), or compare the sizes of members that "
        "meet there",
    ),
    FailureRemedy(
        Status.NO_CONVERGENCE,
        lambda f: f.joined and _stalls(f),
        "the residual has stopped shrinking, and units cannot be composed: compare the sizes of members that meet there",
    ),
    FailureRemedy(
        Status.NO_CONVERGENCE,
        lambda f: f.composable,
        "the iteration still moves: take a smaller step, or compose the network (--coupling monolithic)",
    ),
    FailureRemedy(Status.NO_CONVERGENCE, lambda f: f.joined, "the iteration still moves: take a smaller step"),
    FailureRemedy(
        Status.NO_CONVERGENCE,
        lambda f: f.ran_out,
        "the iterations of this step ran out before shorter substeps were tried, and each step has as many: take steps of "
        "{h:.3g} s or shorter, or --order 2 in place of 4 or 6",
    ),
    FailureRemedy(
        Status.NO_CONVERGENCE,
        _at_rounding,
        "the equations hold while the unknowns still move, so something is hardly determined here (a singular configuration, "
        "nearly dependent constraints) and a smaller step is no remedy; a larger one may pass over it",
    ),
    FailureRemedy(
        Status.NO_CONVERGENCE,
        _always,
        "substeps down to {h:.3g} s failed too, so a somewhat smaller step is no remedy: look at the inputs and the state near "
        "this time, which may run to a point without solution",
    ),
    FailureRemedy(
        Status.GROWTH,
        lambda f: bool(f.put_off),
        "what {put_off} will do in a step is predicted, since it cannot take one back, and badly: put a softer element that "
        "stores energy where it is joined, export it with saved states, or try --coupling gauss-seidel",
    ),
    FailureRemedy(
        Status.GROWTH,
        lambda f: f.composable,
        "members that step once with each other's old outputs make energy in long steps: take a much smaller step, or "
        "--coupling newton or monolithic, which make none at any step (gauss-seidel makes less than jacobi)",
    ),
    FailureRemedy(
        Status.GROWTH,
        _always,
        "members that step once with each other's old outputs make energy in long steps: take a much smaller step, or "
        "--coupling newton if the units can save their state (gauss-seidel makes less than jacobi)",
    ),
    FailureRemedy(
        Status.SINGULAR,
        lambda f: f.signals,
        "the loop of these signals has no unique solution (outputs follow inputs at once, with a gain of 1): put a delay or a "
        "filter into it, or " + UNITERATED,
    ),
    FailureRemedy(
        Status.SINGULAR,
        lambda f: f.joined,
        "nothing determines what is shared there (ideal sources joined, or members without inertia, compliance or resistance): "
        "put an element that stores or dissipates between them",
    ),
    FailureRemedy(Status.SINGULAR, _always, "check that every unknown is determined by an equation (`phfmu check`)"),
    FailureRemedy(
        Status.NOT_FINITE,
        _instant,
        "check start values, inputs and parameters; H and its gradient must be finite there",
    ),
    FailureRemedy(
        Status.NOT_FINITE,
        lambda f: f.joined,
        "check inputs and parameters of the members, or take a smaller step if a state leaves the domain of H",
    ),
    FailureRemedy(
        Status.NOT_FINITE,
        _always,
        "check inputs and parameters; substeps down to {h:.3g} s failed too, so the state itself leaves the domain of H here",
    ),
    FailureRemedy(
        Status.LU_CAPACITY,
        _always,
        "discretise the model again, so that the memory is planned for its present structure",
    ),
    FailureRemedy(Status.ABI, _always, "empty the cache folder (PHFMU_CACHE_DIR) and build again"),
    FailureRemedy(
        Status.ARGUMENT,
        _always,
        "time and step must be finite, the parts at least 1, and node inputs need a Gauss scheme",
    ),
    FailureRemedy(Status.VALUE, _always, "look for its source: inputs, parameters and states must be numbers"),
    FailureRemedy(
        Status.NO_SENSITIVITY,
        _always,
        "take a step first, a shorter one if most of its internal steps were halved, or use finite differences",
    ),
)


def remedy(failure: StepFailure) -> str:
    """The first remedy that is true for the facts of a failure; "" if there is none."""
    for r in REMEDIES:
        if r.status is failure.status and r.holds(failure):
            facts = {n: getattr(failure, n) for n in ("h", "asked", "longest", "put_off", "unsteady")}
            return r.text.format(**facts)
    return ""


#: why, in the order of `ph_event_reason` in runtime/events/events.h, and of modes in runtime/modes/modes.h: what is
#: wrong, and the next move
REASONS = (
    (
        "the jumps of {names} depend on each other (S is singular)",
        "let one of them act where they meet, events that close a loop have no unique impulse",
    ),
    ("{names} would jump with |c| = {value:.6g}, more than its most = {limit:.6g}", "let it jump later, or allow more"),
    (
        "the jumps of {names} together gain {value:.6g} J: their restitutions differ",
        'give events that happen together one restitution, or let contacts push only (Jump(law="unilateral"))',
    ),
    (
        f"{int(LIMITS['MOST_EVENTS'])} events fall into one step, the last {{names}}",
        "declare what holds where they come to rest (StateEvent(rest=..), a Switch with a restitution has it), or give a relay a "
        "hysteresis",
    ),
    (
        "{names} happens again at the same instant, after each event was tried",
        "let the guards of its modes exclude each other: `when` of each, and what it sets",
    ),
    (
        f"{int(LIMITS['MOST_EVENTS'])} events fall into one step, at one instant, the last {{names}}: each drives the state back "
        "over a guard, where it would bounce without end or slide along (Coulomb friction, a relay without hysteresis)",
        "declare what holds where a bounce comes to rest (StateEvent(rest=..), a Switch with a restitution has it); sliding "
        "has no mode: round the force off (F tanh(v/v0) for F sign(v)), give a relay a hysteresis",
    ),
    (
        "after {names} no mode of the switches obeys their laws",
        "give the current that is cut a way to go (a diode beside a switch), or a source an impedance",
    ),
    (
        "{names} opens where its share of least norm is 0, but could hold up to {value:.6g}: the switches depend on each other, "
        "and what holds is not determined",
        "leave one of them out, or give them a stiffness (a resistance), which says what each takes",
    ),
    (
        "the jump of {names}, {value:.6g} J, moves what a junction ties to other members (a rigid link, a node of inductors), "
        "and no impulse reaches those that are stepped apart",
        "compose the network (--coupling monolithic), or make one member of what jumps together",
    ),
)
#: place of the last, which only members have
ACROSS = len(REASONS) - 1


class EventRefused(StepFailure):
    """A state event that cannot happen; `guards` are its names, `reason` its place in REASONS."""

    def __init__(self, component: str, t: float, reason: int, guards: Sequence[str], value: float, limit: float):
        super().__init__(Status.EVENT, component, t, 0.0)
        self.guards, self.reason, self.value, self.limit = tuple(guards), reason, value, limit

    def _text(self) -> str:
        what, advice = REASONS[self.reason]
        names = ", ".join(f"'{g}'" for g in self.guards)
        return (
            f"{self.component} at t = {self.time:.9g} s: {what.format(names=names, value=self.value, limit=self.limit)}. "
            f"Next: {advice}."
        )
