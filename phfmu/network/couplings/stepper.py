"""The interface of the run loop to what it drives: one composed model, one unit or coupled members."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booking import Booking
from phfmu.outcome.steps import StepEvent, Steps

if TYPE_CHECKING:
    from phfmu.discretise.start import Projection
    from phfmu.engine.rest_changes import RestChange
    from phfmu.network.members.interpolant import Interpolant
    from phfmu.signals import SignalKind

Array = NDArray[np.float64]


#: starts and sizes of steps, the steps, or an event and the row after it
Landing = tuple[Array, Array, Steps | None, tuple[StepEvent, Array] | None]


@runtime_checkable
class Follows(Protocol):
    """A stepper whose `free_inputs` may follow data."""

    followed: Interpolant | None

    @property
    def free_inputs(self) -> Mapping[str, Any]: ...


class Stepper(Protocol):
    """Drives a system through n steps, numbers first..first+n-1 of the grid t0 + k h.

    When a step fails, the state is that of the last accepted one and StepFailure.recorded["steps"] holds those before.
    """

    names: list[str]
    booking: Booking
    #: what it is, and how to get one composed model instead; for messages
    what: str
    instead: str

    @property
    def units(self) -> dict[str, str]:
        """Units of `names` and of the free inputs; "1" is none."""
        ...

    @property
    def kinds(self) -> Mapping[str, SignalKind]:
        """Kinds of `names`, as far as they are told by more than their form."""
        ...

    @property
    def labels(self) -> Mapping[str, str]:
        """Readers' names of those of `names` and inputs whose entries have names."""
        ...

    def inputs(self) -> dict[str, float]:
        """Free inputs, which nothing inside feeds, as they are now."""
        ...

    @property
    def unwritten(self) -> Sequence[str]:
        """Units whose states cannot be written to a file, and why."""
        ...

    @property
    def lands(self) -> bool:
        """Whether its steps end on the zeros of guards too, by `land`."""
        ...

    def hashed(self) -> dict[str, dict[str, float]]:
        """By member its states and its time, by their names in it."""
        ...

    @property
    def junctions(self) -> Array:
        """The unknowns between members that the next step goes on from."""
        ...

    @property
    def modes(self) -> tuple[int, ...]:
        """The modes of ideal switches, 0 or 1 each."""
        ...

    def notes(self) -> list[str]:
        """Lines about the run so far that only it knows."""
        ...

    def settable(self) -> list[str]: ...
    def set_value(self, name: str, value: float) -> str: ...
    def read(self) -> Array: ...
    def energies(self) -> Array: ...
    def rest_changes(self) -> dict[str, list[RestChange]]:
        """Member ("" for a whole system) -> the last changes of its constraints at rest."""
        ...

    def check_start(self) -> None: ...
    def check_changed(self) -> None:
        """Check of `check_start`, after a value was set within the run."""
        ...

    def project_start(self, t0: float, kept: Sequence[str] = ()) -> Projection | None: ...
    def prepare(self, t0: float, h: float) -> None:
        """Once before the first step, of size h: what `read` shows of a step is of a trial step that is taken back."""
        ...

    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps: ...
