"""Steps of a composed model that derivatives go along with, forward or backwards: what both need, and refuse."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import IndependentVariables, ScalarData
from phfmu.derivatives.event_maps import EventMaps
from phfmu.derivatives.mode_entry import ModeEntry
from phfmu.derivatives.tangents import in_parts, require_derived
from phfmu.discretise.model import Model
from phfmu.discretise.start import Projection
from phfmu.engine.native.reverse import NativeTapes
from phfmu.engine.record import Grid
from phfmu.events.modes import Mode, Modes
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.stepper import Landing
from phfmu.network.members.inputs import Inputs
from phfmu.network.scene import Event
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.steps import EventRecord, Landed, StepEvent, Steps
from phfmu.schemes.scheme import Scheme

Array = NDArray[np.float64]

#: parts of steps that a tape takes beside the grid steps asked for: those around events, and those that are tried
ROOM = 1024


@dataclass(frozen=True)
class LandedSteps:
    """A part of a run with state events: steps under the same parameters, perhaps none, and what happened at their end.

    x: states at the start (nx);  rows: of their tape;  u, p: inputs (nu) and parameters before, `after`: parameters (np) after
    what happened;  mode, entered: of ideal switches, before and after, None without such
    """

    part: Landed
    x: Array
    rows: Array
    u: Array
    p: Array
    after: Array
    mode: Mode | None
    entered: Mode | None


def mode_after(modes: Modes, mode: Mode, switched: Sequence[str]) -> Mode:
    """The mode after switches went to the sides that are told in words."""
    place, found = {s.name: i for i, s in enumerate(modes.switches)}, list(mode)
    for name, _, side in (word.rpartition(" ") for word in switched):
        found[place[name]] = int(side == "on")
    return tuple(found)


def span(t: Array, h: Array) -> tuple[float, float]:
    """Times between which all parts of some steps begin, and no others; none for no steps."""
    return (float(t[0] - 1e-9 * h[0]), float(t[-1] + (1 - 1e-9) * h[-1])) if len(t) else (-np.inf, -np.inf)


class SimultaneousEvents(Protocol):
    """State events that happened at one instant."""

    @property
    def t(self) -> float: ...
    @property
    def events(self) -> tuple[int, ...]: ...
    @property
    def rests(self) -> tuple[int, ...]: ...


def close_events(met: Sequence[SimultaneousEvents], names: Sequence[str], h: float) -> list[str]:
    """Lines on state events, by number of the guards `names`, in steps of length h, whose sequence other values may change."""
    found, near = list[str](), LIMITS["PILE_UP"] * h
    for e in met:
        if e.rests:
            piled, many = (
                " and ".join(names[i] for i in e.rests),
                sum(set(e.rests) <= set(m.events) for m in met),
            )
            found.append(
                f"{piled} at t = {e.t:.9g} s: events pile up and end there; derivatives are those of the {many} that "
                "happened, of which other values have more or fewer"
            )
    for e, other in pairwise(met):
        if 0.0 < other.t - e.t < near and set(e.events) != set(other.events):
            one, two = (" and ".join(names[i] for i in m.events) for m in (e, other))
            found.append(
                f"{one} at t = {e.t:.9g} s and {two} {other.t - e.t:.2g} s later: with other values they may happen in "
                "another order, which derivatives do not know"
            )
    return found


def identity_of(model: Model) -> tuple[Any, ...]:
    """The model with its scheme and start values, which tell runs that are kept from those of others."""
    d = model.declaration
    names = [v.name for v in (*d.states, *d.parameters)]
    return model.name, model.scheme.name, model.step.k, names, model.x0, model.p0, model.u0


class DerivedSteps(Monolithic):
    """Steps of one composed model whose rows are derived by parameters, held inputs or start values `by`.

    Errors: KeyError for names that are none; ValueError for models and steps without derivatives, with the remedy.
    """

    def __init__(self, model: Model, instance: Any, by: Sequence[str]):
        super().__init__(model, instance)
        self.by = IndependentVariables.of(model.declaration, by)
        sides = set() if model.modes is None else {s.mode_name for s in model.modes.modes.switches}
        if found := [n for n in self.by.names if n in sides]:
            raise KeyError(f"{model.name}: '{found[0]}' is the mode of an ideal switch; there is no derivative by it")
        #: what is known of steps of a companion that are not taken yet
        self._tried: Any = None
        #: states after the last step, None before the first one
        self._last: Array | None = None
        maps = None if model.events is None else EventMaps(model, model.events, self.by.directions)
        #: derivatives of state events, and those that happened
        self.maps, self.met = maps, list[EventRecord]()
        self._maps_of: dict[Mode | None, EventMaps | None] = {None: maps}
        #: of entering modes, None without ideal switches
        self.entry = None if model.modes is None else ModeEntry(model.modes.modes, self.by.directions)
        #: states that the start was given, before a projection
        self._given = instance.x[: model.step.nx].copy()

    @property
    def begun(self) -> bool:
        """Steps were taken: a value that is set now belongs to no start."""
        return self._last is not None

    def begin(self, values: Mapping[str, float]) -> None:
        """Back to the start, with other parameters, start values or held inputs, by scalar name."""
        i, d = self.instance, self.model.declaration
        i.reset()
        self._inputs = Inputs(i, self.model)
        p, x = self.model.p0.copy(), self.model.x0.copy()
        states = {n: j for j, n in enumerate(n for v in d.states for n in v.names())}
        for name, value in values.items():
            if name in states:
                x[states[name]] = value
            elif name in self._inputs.parameters:
                p[self._inputs.parameters[name]] = value
            else:
                self._inputs.u[self._inputs.inputs[name]] = value
        i.set_parameters(p)
        i.set_input(self._inputs.u)
        i.set_x(self.model.t0, x)
        i.initialise()
        self._rebook()
        self._given, self._last = x, None
        self.met = []
        self.forget()

    @property
    def sequence(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the state events of the run, one instant after the other."""
        return tuple(e.events for e in self.met)

    @property
    def known(self) -> ScalarData:
        """Start values, sizes, limits and units of what it can be derived by."""
        return ScalarData.of(self.model)

    @property
    def identity(self) -> tuple[Any, ...]:
        """Identity of the run (see `identity_of`)."""
        return identity_of(self.model)

    @property
    def moves(self) -> bool:
        """Whether times of rows move with the values."""
        return self.model.events is not None

    def notes(self) -> list[str]:
        """State events whose sequence other values, however close, may change: derivatives are those of what happened."""
        return (
            [] if self.maps is None or not self.met else close_events(self.met, self.maps.plan.names, self._grid[0].h)
        )

    def forget(self) -> None:
        """Discard the steps so far, which belong to another run."""

    def cut(self, name: str) -> None:
        """A value of a parameter or input is set that does not follow that of the start."""

    def set_value(self, name: str, value: float) -> str:
        kind = super().set_value(name, value)
        if self.begun:
            self.cut(name)
        return kind

    def project_start(self, t0: float, kept: Sequence[str] = ()) -> Projection | None:
        """Project the start as `Monolithic` does; ValueError with states that are kept, which tangents of a start do not know."""
        if kept and not self.begun:
            raise ValueError(f"{self.model.name}: derivatives and --keep {kept[0]} do not go together")
        return super().project_start(t0, kept)

    def measuring(self, scheme: Scheme) -> Any:
        """ValueError: steps within a tolerance have no derivatives."""
        raise ValueError(f"{self.model.name}: derivatives are told of equal steps; leave out --rtol")

    def companion(self, scheme: Scheme) -> Any:
        """The companion of `Monolithic`; raises ValueError with state events, behind which parts of steps would be damped."""
        if self.model.events is not None:
            raise ValueError(
                f"{self.model.name}: derivatives through state events are told of steps that are not damped; leave out "
                "--restart, or the derivatives"
            )
        made = super().companion(scheme)
        require_derived(made.model)
        return made

    def model_of(self, instance: Any) -> Model:
        """The model of the instance, or of a companion."""
        return self.model if instance is self.instance else instance.model

    def kept(self) -> Any:
        """The present derivatives, which `back` restores."""
        raise NotImplementedError

    def back(self, kept: Any) -> None:
        """Restores the derivatives that `kept` told."""
        raise NotImplementedError

    def taken(self, instance: Any, t0: float, h: float, n: int, first: int = 0) -> Steps:
        """Steps that were taken, as in `Monolithic`; those of a companion count once the instance goes on from it (`follow`)."""
        if instance is self.instance:
            return super().taken(instance, t0, h, n, first)
        before = self.kept()
        steps = super().taken(instance, t0, h, n, first)
        self._tried = self.kept()
        self.back(before)
        return steps

    def follow(self, instance: Any, other: Any) -> None:
        super().follow(instance, other)
        if instance is self.instance and self._tried is not None:
            self.back(self._tried)
        self._tried = None

    def advance_with(self, inputs: Sequence[tuple[int, Event]], t0: float, h: float, n: int, first: int = 0) -> Steps:
        """Advance as `Monolithic` does; raises ValueError if an input changes that the run is derived by."""
        self._require_constant([e.name for _, e in inputs])
        return super().advance_with(inputs, t0, h, n, first)

    def _require_constant(self, names: Sequence[str]) -> None:
        """ValueError where names that change, or follow data, are derived by."""
        followed = () if self.followed is None else self.followed.names
        self.by.require_constant(self.model.name, [*names, *followed])

    # -- steps with state events -------------------------------------------------------------------------------------

    def landed(self, instance: Any, grid: Grid, changed: bool) -> Iterator[Landing]:
        self._require_constant(())
        self.require_continued(grid.start(0))
        self._grid = grid, changed
        yield from super().landed(instance, grid, changed)

    def landings(self, instance: Any, before: Array, parts: Iterable[Landed]) -> Iterator[Landing]:
        """The landings of `Monolithic`; each part has been handed to `follow_landed`, which adds to its rows."""
        assert self.maps is not None
        p, u, current = instance.parameters.copy(), instance.held_input.copy(), list[Landed]()
        place, x = instance.layout["x"], instance.x[: self.model.step.nx].copy()
        switched = self.model.modes is not None
        mode = instance.mode if switched else None

        def kept() -> Iterator[Landed]:
            for part in parts:
                current[:] = [part]
                yield part

        with NativeTapes(instance, self._grid[0].n + ROOM) as tapes:
            for t, h, steps, row in super().landings(instance, before, kept()):
                part, happened = current[0], current[0].happened
                tape = tapes.of(mode)
                if tape.full:
                    raise in_parts(self.model, float(t[0]), self._grid[0].h)
                rows = tape.taken(*span(t, h))
                self.met += [] if happened is None else [happened]
                after = p if happened is None else self.maps.after(p, happened.events, happened.rests)
                entered = mode
                if mode is not None and happened is not None and self.model.modes is not None:
                    entered = mode_after(self.model.modes.modes, mode, happened.switched)
                    after = self.model.modes.modes.system.in_mode(after, entered)
                more = self.follow_landed(LandedSteps(part, x, rows, u, p, after, mode, entered), steps, row)
                mode = entered
                x = x if not len(t) else part.rows["signals"][-1, place]
                x, p = x if happened is None else happened.signals[place], after
                self._last = x.copy()
                yield t, h, *more

    def model_in(self, mode: Mode | None) -> Model:
        """The model of a mode."""
        return self.model if mode is None or self.model.modes is None else self.model.modes[mode]

    def maps_in(self, mode: Mode | None) -> EventMaps:
        """Derivatives of the state events of a mode."""
        if mode not in self._maps_of:
            model = self.model_in(mode)
            assert model.events is not None
            self._maps_of[mode] = EventMaps(model, model.events, self.by.directions)
        found = self._maps_of[mode]
        assert found is not None
        return found

    def follow_landed(
        self, found: LandedSteps, steps: Steps | None, row: tuple[StepEvent, Array] | None
    ) -> tuple[Steps | None, tuple[StepEvent, Array] | None]:
        """Steps and the row after an event, with what derivatives add to them."""
        raise NotImplementedError

    def require_continued(self, t: float) -> None:
        """ValueError where states were moved between two steps."""
        x = self.instance.x[: self.model.step.nx]
        if self._last is not None and not np.array_equal(x, self._last):
            raise ValueError(
                f"{self.model.name}: states were moved at t = {t:.9g} s (a projection after an event), which derivatives do "
                "not follow; let the event keep the constraints"
            )
        self._last = x.copy()
