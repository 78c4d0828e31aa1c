"""The interface of an instance: a component that a master can step, in Python or in compiled code."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.engine.model import EngineModel, require_built, require_one_mode
from phfmu.engine.record import Grid, recordable
from phfmu.outcome.steps import EventRecord, Landed

if TYPE_CHECKING:
    from phfmu.engine.impulses import Ports
    from phfmu.engine.node_sensitivity import NodeSensitivity
    from phfmu.engine.rest_changes import RestChange
    from phfmu.terms.port_impulses import PortImpulse

Array = NDArray[Any]


class Signals(ABC):
    """Base of the classes that tell their values by block."""

    @abstractmethod
    def signals(self) -> dict[str, Array]:
        """All values by block: x, time, a, y_step, energy, supplied, dissipated, residual, a_end, y_end, observables, H."""

    @abstractmethod
    def signal(self, block: str) -> Array:
        """One block of `signals`; those that hold at the present time (from a_end on) are solved for if out of date."""

    def row(self) -> Array:
        """All blocks in a row, as `run` records them."""
        return np.concatenate(list(self.signals().values()))

    @property
    def layout(self) -> dict[str, slice]:
        """Place of each block in a row of recorded signals."""
        place, start = {}, 0
        for name, values in self.signals().items():
            place[name] = slice(start, start + len(values))
            start += len(values)
        return place


class Instance(Signals):
    """A component a master can step: `NativeInstance`, and `PythonInstance`, which lands on no events; the numbers are the same.

    Inputs u (nu) are held over a step, or given at its k quadrature nodes.  `output()` gives step-conjugate
    means, so that h u^T y is the supplied energy exactly.  Units SI, power into the component.
    StepFailure leaves the instance at its last accepted step.
    """

    _ports: Ports

    def __init__(self, model: EngineModel) -> None:
        require_built(model, type(self).__name__)
        require_one_mode(model)
        self.model = model
        #: state events of the last `do_step` or `run`
        self.happened: tuple[EventRecord, ...] = ()

    # -- readings ------------------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def time(self) -> float: ...

    @property
    @abstractmethod
    def x(self) -> Array: ...

    @property
    @abstractmethod
    def unknowns(self) -> Array:
        """w of the last solve: see `Plan`."""

    @property
    @abstractmethod
    def solves(self) -> int:
        """Number of parts in which the last step was solved; 0: none, or more than are known."""

    @property
    @abstractmethod
    def counts(self) -> dict[str, int]:
        """Counters of the solver since the reset: steps, solves, iterations, restarts, line_searches, substeps, ..."""

    @property
    @abstractmethod
    def rest_changes(self) -> list[RestChange]:
        """The redundant constraints that rest instead of others, by the last changes since the start."""

    @abstractmethod
    def output(self) -> Array:
        """Step-conjugate means of the external pairs (nu)."""

    @abstractmethod
    def node_output(self) -> Array:
        """Outputs at the k quadrature nodes (k x nu): h sum_i b_i u_i^T y_i is the supplied energy of the last step."""

    @abstractmethod
    def ledger(self) -> dict[str, Array]:
        """Ledger of the last communication step [J]: stored, dissipated, supplied, numerical, moved by component, pairs."""

    @abstractmethod
    def sensitivity(self, end: bool = False) -> Array:
        """S = d(mean external outputs)/d(held inputs) of the last step (nu x nu): implicit function theorem.

        Internal steps are chained.  `end`: of the outputs at the present time instead.  StepFailure NO_SENSITIVITY before the
        first step, or where more than 16 internal steps of the last one were halved.
        """

    @abstractmethod
    def node_sensitivity(
        self, inputs: Sequence[int] | None = None, impulses: bool = False, end: bool = False
    ) -> NodeSensitivity:
        """Derivatives of the last step with respect to the chosen inputs (default: all) at each of its nodes.

        `impulses`: then with respect to those at its start and at its end too, in the order of `set_impulses`;  `end`: of the
        outputs at its end too.  StepFailure NO_SENSITIVITY as in `sensitivity`.
        """

    # -- state ---------------------------------------------------------------------------------------------------------

    @abstractmethod
    def reset(self) -> None:
        """Back to the start values; the algebraic variables are solved for the start."""

    @abstractmethod
    def initialise(self) -> None:
        """Solve the instant system; step means take their instantaneous values."""

    @abstractmethod
    def get_state(self) -> Any:
        """A complete copy; stepping after `set_state`, in any instance of the model, gives the same bits."""

    @abstractmethod
    def set_state(self, state: Any) -> None:
        """Restores a state that `get_state` gave."""

    @abstractmethod
    def restore(self, state: Any) -> None:
        """Restores a state as `set_state` does; the counts of the solver go on."""

    @abstractmethod
    def set_x(self, t: float, x: ArrayLike) -> None:
        """Place the state; call `initialise` afterwards."""

    @abstractmethod
    def continue_from(self, other: Self) -> None:
        """Go on from the state, time, held inputs, parameters and cumulative energies of `other`.

        `other` is of the same declaration under another scheme.
        """

    # -- inputs --------------------------------------------------------------------------------------------------------

    @abstractmethod
    def set_input(self, u: ArrayLike) -> None:
        """Inputs (nu), held over the next steps."""

    @abstractmethod
    def set_node_inputs(self, u: ArrayLike) -> None:
        """Inputs at the k quadrature nodes of the next step (k x nu)."""

    @property
    @abstractmethod
    def held_input(self) -> Array:
        """Inputs (nu) as they were set, held."""

    @abstractmethod
    def set_parameters(self, p: ArrayLike) -> None:
        """All parameters (np)."""

    @property
    @abstractmethod
    def parameters(self) -> Array: ...

    @property
    def impulse_ports(self) -> tuple[PortImpulse, ...]:
        """The use of impulses by each external port, and why not more."""
        return self._ports.offered

    def set_impulses(self, s0: ArrayLike, s1: ArrayLike) -> None:
        """Impulses at the start and at the end of the coming steps, each (n) over the inputs of `impulse_ports` that take some.

        x0* = x + L(x) s0, the step, x1 = x1* + L(x1*) s1; [V s] at an electrical port.  Their work is in the ledger and the
        pair energies; outputs at nodes and means are without them.  They stay until set; 0 is as if they had never been.  Steps
        of no length and slivers take none.  In compiled code a small library is made first.  ValueError names the ports.
        """
        if self.model.events is not None:
            names = ", ".join(self.model.events.names[:4])
            raise ValueError(
                f"{self.model.name}: has state events ({names}), which do not go with impulses at its ports"
            )
        self._take_impulses(self._ports.checked(s0, s1))

    @abstractmethod
    def _take_impulses(self, s: Array) -> None:
        """Impulses at start and end (2 x n)."""

    @abstractmethod
    def add_impulse(self, s: ArrayLike) -> None:
        """One more impulse (n) at the end of the last step, which counts as part of it."""

    @abstractmethod
    def jump(self) -> Array:
        """S = L^T H'' L at the present time (n x n): by how much impulses change the outputs, y* = y + S s (A/(V s))."""

    # -- stepping ------------------------------------------------------------------------------------------------------

    @abstractmethod
    def do_step(self, t: float, h: float, parts: int = 1) -> None:
        """One communication step over [t, t + h] in `parts` equal internal steps.

        h < 0 goes back in time: the schemes are symmetric, so a step and the same step back give the old state
        to rounding.  h = 0 leaves the state as it is, books nothing, and gives the means their values at t.
        A sliver, what rounding leaves of a master's clock, books nothing and keeps state and means: |h| up to two
        rounding units of t or 1e-9 of the last internal step.  State events happen where they are, see `happened`; the
        step is told as one, h < 0 and inputs that are not held are refused.
        """

    @abstractmethod
    def skip(self, t: float) -> None:
        """Move to the time t in a step too short to be one: state, multipliers and means stay, nothing is booked."""

    @abstractmethod
    def step_exactly(self, t: float, h: float, parts: int = 1) -> None:
        """`do_step`, however short the step is."""

    def run(
        self,
        t0: float,
        h: float,
        n: int,
        record: Iterable[str] = (),
        inputs: ArrayLike | None = None,
        parts: int = 1,
        first: int = 0,
    ) -> dict[str, Array]:
        """Steps k = first..first+n-1 from t0 + k h; `inputs`: n x nu, one row held over each, or n x k x nu, values at
        the nodes of each.

        `record`: names from RECORD, a row a step each.  pairs, stored, dissipated, supplied, numerical, moved: ledger of
        that step; unknowns: w of its last solve; energy: H per component at its end; counts: iterations and
        solves; signals: see `layout`.  ValueError for other names;  StepFailure has the rows before it in `recorded`.
        """
        names = recordable(self.model.name, record)
        given, plan = None, self.model.step
        if inputs is not None:
            given = self._array(inputs, n, *((plan.k, plan.nu) if np.ndim(inputs) == 3 else (plan.nu,)))
        return self._run(Grid(t0, h, n, first, parts), names, given)

    @abstractmethod
    def _run(self, grid: Grid, names: tuple[str, ...], inputs: Array | None) -> dict[str, Array]: ...

    def land(
        self, t0: float, h: float, n: int, record: Iterable[str] = (), first: int = 0, changed: bool = True, *,
        pause: bool = False,
    ) -> Iterator[Landed]:  # fmt: skip
        """Grid steps k = first..first+n-1 from t0 + k h, which end on the zeros of guards too, where state events happen.

        `record` as for `run`, a row for each step taken;  `changed`: parameters or states were set since the last step;
        `pause`: end after the first event and those that follow it at the same time.  Refusal of the Python engine;
        StepFailure after what was accepted before: EventRefused for an event that cannot happen.
        """
        return self._land(Grid(t0, h, n, first, pause=pause), recordable(self.model.name, record), changed)

    @abstractmethod
    def _land(self, grid: Grid, names: tuple[str, ...], changed: bool) -> Iterator[Landed]: ...

    def expect(self, steps: float) -> None:
        """So many steps will be taken that are not told one by one: a reason to get ready for them, or none."""

    def _array(self, values: ArrayLike, *shape: int) -> Array:
        """Values of this shape; ValueError for others."""
        array = np.ascontiguousarray(values, float)
        if array.shape != shape:
            raise ValueError(f"{self.model.name}: expected values of shape {shape}, got {array.shape}")
        return array
