"""The interface of a coupling to a member, whether Python, native or FMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booking import Booking
from phfmu.engine.rest_changes import RestChange
from phfmu.outcome.steps import StepEvent
from phfmu.signals import SignalKind

Array = NDArray[np.float64]


class Member(Protocol):
    """The interface of a coupling to a member; `places`: port name -> slice of the stacked external inputs.

    `input_sign` (nu): times it, an input called by its name counts into the member in units of the domain: -1 at outward
    ports of units, 1000 where a unit says kN.
    `saves`: whether it can give its state and take it back.
    `finishes`: whether a step that was accepted has to be ended by `finish`.
    `repeated`: how much steps that it takes again differ, relative to its outputs; 0: by rounding.
    `taken`, `sent`: signals that it exchanges at the nodes of its steps, with their places among inputs and outputs.
    """

    name: str
    nu: int
    names: list[str]
    places: dict[str, slice]
    nominal: Array
    input_sign: Array
    booking: Booking
    taken: dict[str, int]
    sent: dict[str, int]

    @property
    def saves(self) -> bool: ...
    @property
    def unwritten(self) -> str:
        """Its name and why its state cannot be written to a file; "" if it can."""
        ...

    @property
    def finishes(self) -> bool: ...
    @property
    def repeated(self) -> float: ...
    @property
    def ended(self) -> bool:
        """Whether it has asked to end the simulation in the last step."""
        ...

    @property
    def units(self) -> dict[str, str]:
        """Units of `names`, of the inputs of ports and of the signals that it takes."""
        ...

    @property
    def kinds(self) -> Mapping[str, SignalKind]:
        """Kinds of `names`, as far as they are told by more than their form."""
        ...

    @property
    def labels(self) -> Mapping[str, str]:
        """Readers' names of those of `names` and inputs whose entries have names."""
        ...

    @property
    def input_names(self) -> list[str]:
        """The inputs of its ports, in their order."""
        ...

    def signals(self) -> dict[str, float]:
        """The signals that it takes as they are now."""
        ...

    def settable(self) -> list[str]: ...
    def input_places(self, name: str) -> list[int]: ...
    def set_parameter(self, name: str, value: float) -> str:
        """Set a parameter ("parameter") or signal input ("input"); "" if there is none of that name."""
        ...

    def read_signals(self, names: Sequence[str]) -> Array:
        """States and outputs at the present time, by scalar name."""
        ...

    def write_signals(self, names: Sequence[str], values: Array) -> None:
        """Signal inputs by scalar name, held from now on."""
        ...

    def start_inputs(self) -> Array: ...
    def set_input(self, u: Array) -> None: ...
    def begin(self, u: Array) -> None:
        """Inputs before the first step; what the member tells of the start follows them."""
        ...

    def do_step(self, t: float, h: float) -> None: ...
    def finish(self) -> None:
        """The step of a member that `finishes`, for good: the one that was put off, or the accepted one once more."""
        ...

    def output(self) -> Array: ...
    def end_output(self) -> Array: ...
    def sensitivity(self) -> Array:
        """G = dY/dU of the last step under held inputs; StepFailure (NO_SENSITIVITY) where it does not know it."""
        ...

    def get_state(self) -> Any: ...
    def set_state(self, state: Any) -> None: ...
    def unsteady(self, h: float, /) -> str:
        """The difference when a step from here is repeated, in words; "" if there is none."""
        ...

    def hashed(self) -> dict[str, float]:
        """The values that tell where it is, by name: its states and its time, or all that it tells."""
        ...

    def ledger(self) -> dict[str, Array]: ...
    def happened(self) -> list[StepEvent]:
        """Events within the last step."""
        ...

    def energies(self) -> Array: ...
    def read(self) -> Array: ...
    def rest_changes(self) -> list[RestChange]: ...
    def check_start(self) -> None: ...
