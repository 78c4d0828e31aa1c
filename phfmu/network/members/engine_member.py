"""Members stepped by an engine, Python or native."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booking import Booking
from phfmu.discretise.constant_energy import Constants
from phfmu.discretise.model import Model, build_model
from phfmu.engine.impulses import port_kernels
from phfmu.engine.rest_changes import RestChange
from phfmu.network.members.columns import SignalColumns, booked, booking
from phfmu.network.members.consistent import MONOLITHIC, require_consistent
from phfmu.network.members.event_texts import EventTexts
from phfmu.network.members.inputs import Inputs, places
from phfmu.network.signal_ports import signal_places
from phfmu.outcome.steps import StepEvent
from phfmu.schemes.scheme import Scheme
from phfmu.signals import SignalKind, labels, of_member

Array = NDArray[np.float64]


class EngineMember:
    """A member stepped by a Python or native instance of its model, in `parts` equal internal steps per step."""

    saves, finishes, repeated, ended, unwritten = True, False, 0.0, False, ""
    CARRIED = ("instance", "_inputs", "booking")

    def __init__(self, name: str, model: Model, instance: Any, parts: int = 1):
        self.name, self.model, self.instance, self.parts = name, model, instance, parts
        self._inputs = Inputs(instance, model)
        d = model.declaration
        #: signals that it exchanges at the nodes of its steps, with their places among inputs and outputs
        self.taken, self.sent = signal_places(d)
        free = [p for p in d.ports if p.external]
        self.nu = sum(p.n for p in free)
        self.places, start = {}, 0
        for p in free:
            self.places[p.name] = slice(start, start + p.n)
            start += p.n
        self.nominal = np.concatenate(
            [np.broadcast_to(np.asarray(p.nominal, float), p.n) for p in free] or [np.zeros(0)]
        )
        self.input_sign = np.ones(self.nu)
        #: its steps look at no guard: all members land together
        self.together = False
        self._event_texts = None if model.events is None else EventTexts(model, name)
        self._constants = Constants(model)
        own = booking(model, self._constants.booked(instance.parameters))
        rename = {model.name: name}
        self.booking = Booking(
            tuple(rename.get(c) or of_member(name, c) for c in own.components),
            tuple(replace(p, component=rename.get(p.component) or of_member(name, p.component)) for p in own.ports),
            constants=own.constants,
        )
        self._booked = booked(model)
        self._columns = SignalColumns(model, instance.layout)
        self.names = self._columns.names

    @property
    def between_inputs(self) -> str:
        """Why it has no steps of its own, which is told; "" if it has."""
        bound = [] if self.model.modes is None else self.model.modes.modes.system.between_inputs
        if not bound:
            return ""
        return (
            f"member '{self.name}' has ideal switches ({', '.join(bound[:4])}) between inputs, which other members set, so that "
            "none of its own values follows where they are closed; leave out --coupling, so that the network is composed, "
            "or make one member of them and what is on one side"
        )

    def become(self, instance: Any) -> None:
        """Is stepped by another instance of its model from now on."""
        self.instance, self._inputs = instance, Inputs(instance, self.model)

    def companion(self, scheme: Scheme) -> EngineMember:
        """A member of the same declaration and engine under another scheme."""
        model = build_model(self.model.declaration, scheme)
        return EngineMember(self.name, model, type(self.instance)(model), self.parts)

    def follow(self, other: EngineMember) -> None:
        """Goes on from another of the same declaration under another scheme."""
        u = other._inputs.u.copy()
        other.set_input(u)  # of what was told at nodes, the mean
        self.instance.continue_from(other.instance)
        self._inputs.u = u

    @property
    def units(self) -> dict[str, str]:
        return self._columns.units | self._inputs.units

    @property
    def kinds(self) -> dict[str, SignalKind]:
        return self._columns.kinds

    @property
    def labels(self) -> Mapping[str, str]:
        return labels(self.model.declaration)

    @property
    def input_names(self) -> list[str]:
        return [n for p in self.model.declaration.ports if p.external for n in p.input_names()]

    def signals(self) -> dict[str, float]:
        return self._inputs.signals()

    def settable(self) -> list[str]:
        return [*self._inputs.parameters, *self._inputs.inputs]

    def input_places(self, name: str) -> list[int]:
        return places(self._inputs.inputs, name)

    def set_parameter(self, name: str, value: float) -> str:
        kind = self._inputs.set(name, value) if places(self._inputs.parameters, name) else ""
        if kind and (held := self._constants.booked(self.instance.parameters)) != self.booking.constants:
            self.booking = replace(self.booking, constants=held)
        return kind

    def read_signals(self, names: Sequence[str]) -> Array:
        return self._columns.some(self.instance, tuple(names))

    def write_signals(self, names: Sequence[str], values: Array) -> None:
        p = self.instance.parameters
        p[[self._inputs.parameters[n] for n in names]] = values
        self.instance.set_parameters(p)

    def place(self, name: str) -> tuple[int, int]:
        """First entry of a row of recorded signals, and how many are added, of a column."""
        return self._columns.place(name)

    def parameter_places(self, names: Sequence[str]) -> list[int]:
        """Places of signal inputs among the parameters."""
        return [self._inputs.parameters[n] for n in names]

    def start_inputs(self) -> Array:
        return self.model.u0.copy()

    def set_input(self, u: Array) -> None:
        self._inputs.u = u.copy()
        self.instance.set_input(u)

    def took(self, u: Array) -> None:
        """Compiled code has given it the inputs u, and stepped it."""
        self._inputs.u = u.copy()

    @property
    def states(self) -> dict[str, float]:
        names = [n for v in self.model.declaration.states for n in v.names()]
        return dict(zip(names, map(float, self.instance.x), strict=True))

    def begin(self, u: Array) -> None:
        self.set_input(u)
        self.instance.initialise()

    def shift(self, s: Array, t: float) -> None:
        """Moves the states as an impulse s at the ports that take some does, for a start at time t."""
        kernels, x = port_kernels(self.model.declaration), self.instance.x
        x[list(kernels.forms.states)] += np.array(kernels.shift(x, self.instance.parameters, s)[0]).ravel()
        self.instance.set_x(t, x)
        self.instance.initialise()

    @property
    def guards_states(self) -> bool:
        """Whether its state events read states only, so that they can be looked at on the polynomial of a step."""
        events = self.model.events
        if self.model.modes is not None:  # their steps have no inputs at nodes
            return False
        return self.parts == 1 and events is not None and not any(g.yi.size for g in events.groups)

    def do_step(self, t: float, h: float) -> None:
        if self.together:
            self.instance.step_exactly(t, h)
        else:
            self.instance.do_step(t, h, self.parts)

    def finish(self) -> None:
        """A step that was taken is one."""

    def output(self) -> Array:
        return self.instance.output()

    def end_output(self) -> Array:
        return self.instance.signal("y_end")[: self.nu]

    def sensitivity(self) -> Array:
        return self.instance.sensitivity()

    def get_state(self) -> Any:
        return self.instance.get_state()

    def set_state(self, state: Any) -> None:
        self.instance.set_state(state)

    def unsteady(self, _: float) -> str:
        """States of engines are complete."""
        return ""

    def hashed(self) -> dict[str, float]:
        """Its states and its time."""
        return self.states | {"time": float(self.instance.time)}

    def ledger(self) -> dict[str, Array]:
        book = self.instance.ledger()
        if len(self.taken) or len(self.sent):
            book["pairs"] = self.pairs(book["pairs"])
        return book

    def pairs(self, energies: Array) -> Array:
        """Energies of all pairs (.. x pairs) -> of those that are booked."""
        return energies if len(self._booked) == energies.shape[-1] else energies[..., self._booked]

    def happened(self) -> list[StepEvent]:
        told = self._event_texts
        return [] if told is None or self.together else [told.told(h) for h in self.instance.happened]

    def energies(self) -> Array:
        return self.instance.signal("H")

    def read(self) -> Array:
        return self._columns.now(self.instance)

    def columns(self, signals: Array) -> Array:
        """Rows of recorded signals -> rows of `names`."""
        return self._columns.pick(signals)

    def rest_changes(self) -> list[RestChange]:
        return self.instance.rest_changes

    def check_start(self) -> None:
        require_consistent(self.model, self.instance, MONOLITHIC)
