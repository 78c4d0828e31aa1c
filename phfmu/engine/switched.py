"""An instance of a model with switches: one instance for each mode, the state goes from one to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.discretise.model import Model
from phfmu.engine.instance import Signals
from phfmu.engine.model import require_no_landing
from phfmu.engine.record import Grid, recordable
from phfmu.engine.reference.python import PythonInstance
from phfmu.events.modes import Mode
from phfmu.outcome.limits import is_sliver
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import EventRecord, Landed

if TYPE_CHECKING:
    from phfmu.engine.native.native_modes import NativeModes
    from phfmu.engine.node_sensitivity import NodeSensitivity

Array = NDArray[Any]


def stepped(model: Model, make: Callable[[Model], Any]) -> Any:
    """An instance of a model, with or without switches."""
    return make(model) if model.modes is None else SwitchedInstance(model, make)


class SwitchedInstance(Signals):
    """Steps a model with switches in its present mode and changes modes at events, where it `land`s.

    `make`: makes a `NativeInstance`, of which it has one for each mode that came up so far.  Rows of signals are
    those of the model; the hidden constraints of a mode hold by what entering it does.
    """

    def __init__(self, model: Model, make: Callable[[Model], Any]):
        if model.modes is None:
            raise ValueError(f"{model.name} has no switches: make the instance itself")
        if make is PythonInstance:
            require_no_landing(model)
        self.model, self._models, self._make = model, model.modes, make
        self._mode = self._models.modes.start
        self._instances: dict[Mode, Any] = {self._mode: make(self._models[self._mode])}
        self._fresh = {self._mode: self.present.get_state()}
        self._asked = self._mode
        self.typical_step = 0.0  #: what it was prepared for
        self._started, self._last = False, 0.0
        #: called with each instance that is made
        self.made: Callable[[Any], None] | None = None
        #: state events of the last `do_step`
        self.happened: tuple[EventRecord, ...] = ()

    @property
    def kernels(self) -> str:
        """The form of the kernels of the present mode: compiled or interpreted."""
        return self.present.kernels

    @property
    def mode(self) -> Mode:
        """1 or 0 for each switch, in the order of the declaration."""
        return self._mode

    @property
    def present(self) -> Any:
        """The instance of the present mode."""
        return self._of(self._mode)

    def _of(self, mode: Mode) -> Any:
        if mode not in self._instances:
            made = self._instances[mode] = self._make(self._models[mode])
            self._fresh[mode] = made.get_state()
            if self.made is not None:
                self.made(made)
        return self._instances[mode]

    @property
    def instances(self) -> list[Any]:
        """Instances of the modes that came up so far."""
        return list(self._instances.values())

    def _entered(self, mode: Mode) -> Any:
        """The instance of a mode, which goes on from the present one and knows nothing of when it was in use before."""
        old, new = self.present, self._of(mode)
        if new is not old:
            new.restore(self._fresh[mode])
            new.continue_from(old)
        return new

    def prepare(self, h: float) -> None:
        """Steps will be about as long as h: modes are tried over a small part of it where nothing else says what is short."""
        self.typical_step = h

    @property
    def sides(self) -> tuple[int, ...]:
        """1 once its mode fits the state, then the mode, then the one that was asked for: all that compiled code changes."""
        return int(self._started), *self._mode, *self._asked

    @sides.setter
    def sides(self, values: Sequence[int]) -> None:
        n = len(self._mode)
        self._started, self._mode, self._asked = bool(values[0]), tuple(values[1 : n + 1]), tuple(values[n + 1 :])

    def of(self, mode: Mode) -> tuple[Any, Any]:
        """The instance of a mode, and its state when it was new."""
        return self._of(mode), self._fresh[mode]

    @cached_property
    def native(self) -> NativeModes:
        """Changes of modes in compiled code, of native instances."""
        from phfmu.engine.native.native_modes import NativeModes

        return NativeModes(self)

    @property
    def unsettled(self) -> bool:
        """Modes were set, or it has not landed yet, so that its modes may not fit its state."""
        return self._asked != self._mode or not self._started

    def settle(self) -> None:
        """Accept the modes that were set as they are: the impulses they need were decided elsewhere, with the state."""
        p = self.parameters
        self._entered(self._asked).set_parameters(p)
        self._mode, self._started = self._asked, True

    def land(
        self, t0: float, h: float, n: int, record: Iterable[str] = (), first: int = 0, changed: bool = True, *,
        pause: bool = False,
    ) -> Iterator[Landed]:  # fmt: skip
        """Grid steps that end on the zeros of guards too, where modes change; see `Instance.land`."""
        grid, names = Grid(t0, h, n, first, pause=pause), recordable(self.model.name, record)
        return self.native.land(grid, names, changed)

    def do_step(self, t: float, h: float, parts: int = 1) -> None:
        """One communication step in `parts` equal internal steps, h >= 0; modes change in it, and it is told as one.

        A sliver is skipped; inputs that are not held are refused.
        """
        self.happened = ()
        if h > 0 and is_sliver(t, h, self._last):
            self.present.skip(t + h)
            return
        if h == 0:
            self.present.step_exactly(t, h)
            return
        before = self.get_state()
        try:
            self.happened = self.native.step(t, h, parts)
        except StepFailure:
            self.restore(before)
            raise
        self._last = h / parts

    def step_exactly(self, t: float, h: float) -> None:
        """A step in the present mode; no guard is looked at."""
        self.happened = ()
        self.present.step_exactly(t, h)
        self._last = h or self._last

    @property
    def time(self) -> float:
        return self.present.time

    @property
    def x(self) -> Array:
        return self.present.x

    @property
    def solves(self) -> int:
        return self.present.solves

    @property
    def unknowns(self) -> Array:
        """w of the last solve, of the plan of the present mode."""
        return self.present.unknowns

    @property
    def held_input(self) -> Array:
        return self.present.held_input

    @property
    def counts(self) -> dict[str, int]:
        """Counters of all modes together."""
        found = [i.counts for i in self._instances.values()]
        return {name: sum(c[name] for c in found) for name in found[0]}

    @property
    def rest_changes(self) -> list[Any]:
        """Constraints that rest are none."""
        return []

    @property
    def parameters(self) -> Array:
        """All parameters; modes as they were set, which the next landing takes."""
        return self._models.modes.system.in_mode(self.present.parameters, self._asked)

    def set_parameters(self, p: ArrayLike) -> None:
        """Set all parameters (np).  Modes among them change at the next landing, where the loss of that is booked."""
        values, system = np.asarray(p, float), self._models.modes.system
        self._asked = tuple(int(values[i]) for i in system.places)
        self.present.set_parameters(system.in_mode(values, self._mode))

    def set_input(self, u: ArrayLike) -> None:
        self.present.set_input(u)

    def set_node_inputs(self, u: ArrayLike) -> None:
        """Values at the nodes of the next step (k x nu), for `step_exactly`; `do_step` takes held ones only."""
        self.present.set_node_inputs(u)

    def node_output(self) -> Array:
        """Outputs at the nodes of the last step (k x nu)."""
        return self.present.node_output()

    def set_x(self, t: float, x: ArrayLike) -> None:
        """Place the state; the next landing finds the mode that it has."""
        self.present.set_x(t, x)
        self._started = False

    def initialise(self) -> None:
        self.present.initialise()

    def continue_from(self, other: SwitchedInstance) -> None:
        """Go on from another of the same declaration under another scheme, in its mode."""
        self._asked, self._started, self.typical_step = other._asked, other._started, other.typical_step
        self._last = other._last
        if self._mode != other._mode:
            self._mode = other._mode
            self.present.restore(self._fresh[self._mode])
        self.present.continue_from(other.present)

    def reset(self) -> None:
        """Back to the start values and modes."""
        self._mode = self._asked = self._models.modes.start
        self._started, self._last = False, 0.0
        self.present.reset()

    def ledger(self) -> dict[str, Array]:
        return self.present.ledger()

    def output(self) -> Array:
        """Step-conjugate means of the external pairs (nu)."""
        return self.present.output()

    def sensitivity(self) -> Array:
        """d(mean external outputs)/d(held inputs) of the last step; StepFailure NO_SENSITIVITY if something happened in it."""
        return self.present.sensitivity()

    def node_sensitivity(self, inputs: Sequence[int] | None, impulses: bool, end: bool) -> NodeSensitivity:
        """Sensitivity of the last step, taken exactly; see `Instance.node_sensitivity`."""
        return self.present.node_sensitivity(inputs, impulses, end)

    def signals(self) -> dict[str, Array]:
        return {block: self._shown(block, values) for block, values in self.present.signals().items()}

    def signal(self, block: str) -> Array:
        return self._shown(block, self.present.signal(block))

    def _shown(self, block: str, found: Array) -> Array:
        """A block without the values that only the mode has."""
        return found[: len(self.model.observable_names)] if block == "observables" else found

    def get_state(self) -> Any:
        """A complete copy, modes included."""
        own = self._mode, self._asked, self._started, self._last, self.typical_step
        return own, self.present.get_state()

    def set_state(self, state: Any) -> None:
        """Restores a state that `get_state` gave; stepping on gives the same bits, over changes of modes too."""
        inner = self._own_state(state)
        self.present.set_state(inner)

    def restore(self, state: Any) -> None:
        """Restores a state as `set_state` does; the counts of the solver go on."""
        inner = self._own_state(state)
        self.present.restore(inner)

    def _own_state(self, state: Any) -> Any:
        """Take the part of a state that is its own, and return that of the instance of the mode."""
        (self._mode, self._asked, self._started, self._last, self.typical_step), inner = state
        return inner
