"""Members of a coupled network: an instance with its names, whether Python, native or FMU."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.engine.status import Status, StepFailure
from phfmu.network.columns import Columns
from phfmu.network.stepper import PROJECT, Booking, Inputs, booking, places, require_consistent

Array = NDArray[np.float64]


#: members know their own constraints only, so a coupled network cannot be projected
MONOLITHIC = f"compose the network (--coupling monolithic) and {PROJECT}"


class Member(Protocol):
    """What the coupling asks of a member; `places`: port name -> slice of the stacked external inputs."""

    name: str
    nu: int
    names: list[str]
    places: dict[str, slice]
    nominal: Array
    booking: Booking

    def settable(self) -> list[str]: ...
    def input_places(self, name: str) -> list[int]: ...
    def set_parameter(self, name: str, value: float) -> bool: ...
    def start_inputs(self) -> Array: ...
    def set_input(self, u: Array) -> None: ...
    def do_step(self, t: float, h: float) -> None: ...
    def output(self) -> Array: ...
    def end_output(self) -> Array: ...
    def sensitivity(self, t: float, h: float, state: Any) -> Array: ...
    def get_state(self) -> Any: ...
    def set_state(self, state: Any) -> None: ...
    def ledger(self) -> dict[str, Array]: ...
    def energies(self) -> Array: ...
    def read(self) -> Array: ...
    def check_start(self) -> None: ...


def finite_differences(member: Member, u: Array, t: float, h: float, state: Any, nominal: Array) -> Array:
    """G = dY/dU by one-sided differences with rollback (nu extra steps); the member ends at t + h with inputs u."""

    def outputs(value: Array) -> Array:
        member.set_state(state)
        member.set_input(value)
        member.do_step(t, h)
        return member.output()

    base = outputs(u)
    G = np.zeros((len(u), len(u)))
    for j in range(len(u)):
        step = 1e-6 * (nominal[j] + abs(u[j]))
        moved = u.copy()
        moved[j] += step
        G[:, j] = (outputs(moved) - base) / step
    outputs(u)
    return G


class EngineMember:
    """A member stepped by a Python or native instance of its model."""

    def __init__(self, name: str, model: Model, instance: Any):
        self.name, self.model, self.instance = name, model, instance
        self._inputs = Inputs(instance, model)
        d = model.declaration
        free = [p for p in d.ports if p.external]
        self.nu = sum(p.n for p in free)
        self.places, start = {}, 0
        for p in free:
            self.places[p.name] = slice(start, start + p.n)
            start += p.n
        self.nominal = np.concatenate(
            [np.broadcast_to(np.asarray(p.nominal, float), p.n) for p in free] or [np.zeros(0)]
        )
        own = booking(model)
        rename = {model.name: name}
        self.booking = Booking(
            tuple(rename.get(c, f"{name}.{c}") for c in own.components),
            tuple((rename.get(c, f"{name}.{c}"), p, i, j) for c, p, i, j in own.pairs),
        )
        self._columns = Columns(model, instance.layout)
        self.names = self._columns.names

    def settable(self) -> list[str]:
        return [*self._inputs.parameters, *self._inputs.inputs]

    def input_places(self, name: str) -> list[int]:
        return places(self._inputs.inputs, name)

    def set_parameter(self, name: str, value: float) -> bool:
        return bool(places(self._inputs.parameters, name)) and bool(self._inputs.set(name, value))

    def start_inputs(self) -> Array:
        return self.model.u0.copy()

    def set_input(self, u: Array) -> None:
        self._inputs.u = u.copy()
        self.instance.set_input(u)

    def do_step(self, t: float, h: float) -> None:
        self.instance.do_step(t, h)

    def output(self) -> Array:
        return self.instance.output()

    def end_output(self) -> Array:
        return self.instance.signal("y_end")[: self.nu]

    def sensitivity(self, t: float, h: float, state: Any) -> Array:
        try:
            return self.instance.sensitivity()
        except StepFailure as failure:
            if failure.status is not Status.NO_SENSITIVITY:
                raise
            return finite_differences(self, self._inputs.u, t, h, state, self.nominal)

    def get_state(self) -> Any:
        return self.instance.get_state()

    def set_state(self, state: Any) -> None:
        self.instance.set_state(state)

    def ledger(self) -> dict[str, Array]:
        return self.instance.ledger()

    def energies(self) -> Array:
        return self.instance.signal("H")

    def read(self) -> Array:
        return self._columns.now(self.instance)

    def check_start(self) -> None:
        require_consistent(self.model, self.instance, MONOLITHIC)
