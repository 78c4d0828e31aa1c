"""Members that are FMUs, of this package or of another tool.

State events within a step of a unit are read from the outputs it has for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booking import Booking, PortKey
from phfmu.audit.kinds import Quality
from phfmu.engine.rest_changes import RestChange
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.fmu.importer.refusal import UnitCallError, UnitFailure
from phfmu.network.members.inputs import places
from phfmu.outcome.steps import StepEvent
from phfmu.signals import CONSTANT, ENERGY, HAPPENED, JUMPED, SignalKind, port_energy, total
from phfmu.words import counted


class UnitEventTexts:
    """State events of a unit in words, from changes of `energy.events` and `events.*`; `found`: those of the last step."""

    def __init__(self, unit: FMUInstance, name: str):
        known = () if unit.estimated else unit.interface.variables
        self._unit, self._member = unit, name
        self.names = [n for n in (total(JUMPED[0]), *(n for n, _, _ in HAPPENED)) if n in known]
        self.found: list[StepEvent] = []

    def begin(self) -> None:
        """Before a step."""
        if self.names:
            self._before = self._unit.get(self.names)

    def end(self, t: float) -> None:
        """After it, at time t."""
        if not self.names:
            return
        self.found = self.told(t, self._before, self._unit.get(self.names))

    def told(self, t: float, before: Array, after: Array) -> list[StepEvent]:
        """The event of a step that ended at time t, if values of `names` changed over it."""
        change = after - before
        if len(change) == 1 and change[0]:
            name = f"{self._member}: parameters in it"
            return [StepEvent(t, change, np.zeros(1), name, "parameters in the unit", "parameter")]
        if len(change) > 1 and change[1]:
            words = f"{counted(int(change[1]), 'state event')} in the unit"
            return [StepEvent(float(after[2]), change[:1], change[3:], f"{self._member}: {words}", words)]
        return []


Array = NDArray[np.float64]

SHORT = 1e-300  # s, lost in the rounding of any clock
SAME_LENGTH = 1e-9  # relative difference of steps that are equal


def _columns(unit: FMUInstance) -> list[str]:
    variables = unit.interface.variables
    return [n for n in unit.names if variables[n].causality != "input"]


def _booking(unit: FMUInstance, name: str) -> Booking:
    quality = Quality.ESTIMATED if unit.estimated else Quality.EXACT
    ports = []
    for p in unit.ports:
        vector = p.vector or len(p.inputs) > 1
        ports += [PortKey(name, p.name, i + 1 if vector else None, quality=quality) for i in range(len(p.inputs))]
    if _fed_from_inside(unit):
        ports.append(PortKey(name, "inside", quality=quality))
    return Booking((name,), tuple(ports), frozenset({name} if unit.estimated and not ports else ()))


def _fed_from_inside(unit: FMUInstance) -> bool:
    """True if the unit has power ports of its own that no input feeds, such as the source of a grid."""
    own = {port_energy(p.name) for p in unit.ports}
    local = (n for n, v in unit.interface.variables.items() if v.causality == "local" and n not in own)
    return any(n.endswith(ENERGY) for n in local)


class FMUMember:
    """A member of a coupled network that is an FMU, of this package or of another tool.

    finishes: it keeps nothing of the steps that are repeated, so the accepted one is taken once more, for good.
    repeated: how much steps that it takes again differ, relative to its outputs (`Rollback.repeated`).
    """

    CARRIED = ("unit", "booking", "_u", "_given", "_moved", "_length")

    def __init__(self, name: str, unit: FMUInstance, finishes: bool = False, repeated: float = 0.0):
        self.name, self.unit, self.finishes, self.repeated = name, unit, finishes, repeated
        #: signals that it exchanges at the nodes of its steps, behind its ports
        signals = unit.interface.taken, unit.interface.sent
        self.taken = {n: unit.nu + i for i, n in enumerate(signals[0])}
        self.sent = {n: unit.nu + len(self.taken) + i for i, n in enumerate(signals[1])}
        self.nu = unit.nu + len(self.taken) + len(self.sent)
        self.places: dict[str, slice] = {}
        start = 0
        for p in unit.ports:
            self.places[p.name] = slice(start, start + len(p.inputs))
            start += len(p.inputs)
        self.names = _columns(unit)
        # units of this package refuse a step before an output is not finite
        foreign = unit.estimated
        watched = [i for i, n in enumerate(self.names) if foreign and unit.variable(n).causality == "output"]
        self._watched = np.array(watched, int)
        self._inside = _fed_from_inside(unit)
        self._length: float | None = None
        self._constant = unit.interface.energy.get(CONSTANT, "").split()
        self.booking = _booking(unit, name)
        self._rebook()
        self._tunable = frozenset(unit.tunable)
        self._others = [*(n for n in unit.other_inputs if n not in self.taken), *unit.tunable]
        self._u = self.start_inputs()
        #: what was set by name
        self._given: dict[str, float] = {}
        self._moved = False
        more = np.ones(self.nu - unit.nu)
        self.input_sign = np.append(unit.input_sign, more)
        self._event_texts = UnitEventTexts(unit, name)
        self.nominal = np.append(
            np.abs(unit.input_sign) * np.array([unit.variable(n).nominal for n in unit.inputs]), more
        )

    @property
    def ended(self) -> bool:
        """Whether it has asked to end the simulation in the last step."""
        return self.unit.steps.ended

    @property
    def saves(self) -> bool:
        """Whether it does, not only claims it; asked where steps are not repeated, so that it was not tried before."""
        return self._saves_indeed

    @cached_property
    def _saves_indeed(self) -> bool:
        if not self.unit.interface.saves:
            return False
        try:
            self.unit.get_state()
        except UnitCallError:
            return False
        return True

    @property
    def unwritten(self) -> str:
        """Its name and why its state cannot be written to a file; "" if it can."""
        if self.unit.interface.saves and self.unit.interface.serialises:
            return ""
        what = "write its state to a file (canSerialize..)" if self.unit.interface.saves else "save its state"
        return f"{self.name} cannot {what}"

    @property
    def units(self) -> dict[str, str]:
        names = [*self.names, *self.input_names, *self.unit.other_inputs]
        return {n: self.unit.variable(n).unit for n in names}

    @property
    def kinds(self) -> dict[str, SignalKind]:
        """A unit has no word for them."""
        return {}

    @property
    def labels(self) -> dict[str, str]:
        """A unit has no word for them."""
        return {}

    @property
    def input_names(self) -> list[str]:
        return [*self.unit.inputs, *self.taken, *self.sent]

    def signals(self) -> dict[str, float]:
        names = [n for n in self.unit.other_inputs if n not in self.taken]
        return dict(zip(names, self.unit.get(names).tolist(), strict=True)) if names else {}

    def settable(self) -> list[str]:
        return [*self.unit.inputs, *self.taken, *self._others]

    def input_places(self, name: str) -> list[int]:
        return places({n: i for i, n in enumerate([*self.unit.inputs, *self.taken])}, name)

    def set_parameter(self, name: str, value: float) -> str:
        """Tunable parameters and inputs without power; raises ValueError for parameters that are fixed once it is initialised."""
        found = [n for n in self._others if n == name or n.partition("[")[0] == name]
        if found:
            self._given |= dict.fromkeys(found, value)
            self.unit.set(dict.fromkeys(found, value))
            self._rebook()
            return "parameter" if found[0] in self._tunable else "input"
        variables = self.unit.interface.variables.items()
        known = {n: i for i, (n, v) in enumerate(variables) if v.causality == "parameter"}
        if not places(known, name):
            return ""
        raise ValueError(
            f"{self.name}.{name} = {value:g}: this parameter of the FMU is fixed during a run; export it as tunable "
            "(--tunable), set a start value (--set) instead, drive an input, or run the declaration it was made of"
        )

    def _rebook(self) -> None:
        """Book anew the constant of the stored energy that the unit tells, which may follow a parameter that was set."""
        if self._constant and (held := (float(self.unit.get(self._constant).sum()),)) != self.booking.constants:
            self.booking = replace(self.booking, constants=held)

    def read_signals(self, names: Sequence[str]) -> Array:
        return self.unit.get(names)

    def write_signals(self, names: Sequence[str], values: Array) -> None:
        now = dict(zip(names, values.tolist(), strict=True))
        self._given |= now
        self.unit.set(now)

    def start_inputs(self) -> Array:
        starts = [self.unit.variable(n).start or 0.0 for n in self.taken]
        return np.concatenate([self.unit.start_inputs(), starts, np.zeros(len(self.sent))])

    def set_input(self, u: Array) -> None:
        self._u = np.array(u)
        self.unit.set_input(u[: self.unit.nu])
        if self.taken:
            self.unit.set(self._signals(u))

    def took(self, u: Array) -> None:
        """Compiled code has given it the inputs u, and stepped it."""
        self._u = u.copy()

    def _signals(self, u: Array) -> dict[str, float]:
        return {n: float(u[i]) for n, i in self.taken.items()}

    @property
    def states(self) -> dict[str, float]:
        """The variables that have a value at the start and move."""
        names = [n for n in self.names if (v := self.unit.variable(n)).causality == "local" and v.start is not None]
        return dict(zip(names, self.unit.get(names).tolist(), strict=True))

    def shift(self, s: Array, _: float) -> None:
        """Moves the states as an impulse s at the ports that take some does, by a step too short to be one."""
        at, nothing, self._moved = self.unit.at_nodes, np.zeros(len(s)), True
        at.set_impulses(s, nothing)
        try:
            self.unit.do_step(self.unit.time, SHORT)
        finally:
            at.set_impulses(nothing, nothing)

    def begin(self, u: Array) -> None:
        """A unit of this package begins anew with its inputs; one that was moved, or is another tool's, is given them."""
        if self._moved or self.unit.estimated:
            self.set_input(u)
            return
        self._u = np.array(u)
        self.unit.reset(self._given | self._signals(u), u[: self.unit.nu])

    def restart(self, values: dict[str, float], u: Array) -> None:
        """Back to the start with other values of parameters, states and inputs without power, and inputs u."""
        self._given, self._moved, self._length = dict(values), False, None
        self._u = np.array(u)
        self.unit.reset(values, u[: self.unit.nu])
        self._rebook()

    def do_step(self, t: float, h: float) -> None:
        """All of the step; UnitFailure where the unit takes a part of it only, which is taken back, or not this length."""
        self._require_length(t, h)
        self._taken = t, h
        before = self.unit.get_state() if self.unit.early_return else None
        self._event_texts.begin()
        reached = self.unit.do_step(t, h)
        self._event_texts.end(reached)
        if before is not None and reached < t + h:
            self.unit.set_state(before)
            words = [f"last successful time {reached:.9g} s"]
            raise UnitFailure(self.unit.name, t, h, "fmi3DoStep", "part of a step", words)

    def finish(self) -> None:
        """The step that was accepted once more, from where it began, as one that will not be taken back."""
        u = self._u
        self.set_state(self._before)
        self.set_input(u)
        before, self.unit.steps.no_set_prior = self.unit.steps.no_set_prior, True
        try:
            self.do_step(*self._taken)
        finally:
            self.unit.steps.no_set_prior = before

    def _require_length(self, t: float, h: float) -> None:
        if not self.unit.interface.one_step:
            return
        self._length = h if self._length is None else self._length
        if abs(h - self._length) > SAME_LENGTH * self._length:
            what = f"a step of {h:.9g} s after steps of {self._length:.9g} s"
            raise UnitFailure(self.unit.name, t, h, what, "other length")

    def output(self) -> Array:
        return self._with_signals(self.unit.output())

    def end_output(self) -> Array:
        y = self._with_signals(self.unit.end_output())
        if self.sent:
            y[[*self.sent.values()]] = self.unit.get([*self.sent])
        return y

    def _with_signals(self, y: Array) -> Array:
        """Outputs of ports (..), with places for those of signals."""
        return np.append(y, np.zeros(self.nu - len(y))) if self.nu > len(y) else y

    def sensitivity(self) -> Array:
        found, more = self.unit.sensitivity(), self.nu - self.unit.nu
        return np.pad(found, (0, more)) if more else found

    def get_state(self) -> Any:
        state = self.unit.get_state()
        if self.finishes:
            self._before = state
        return state

    def set_state(self, state: Any) -> None:
        if not self.unit.dead:  # the failure is on its way up; nothing may be called any more
            self.unit.set_state(state)

    def unsteady(self, h: float) -> str:
        """Units of this package restore every bit."""
        if not self.unit.estimated:
            return ""
        from phfmu.network.members.rollback import unsteady

        return unsteady(self.unit, h, self.repeated)

    def hashed(self) -> dict[str, float]:
        """States and time of a unit of this package; of another tool, all values that may change."""
        own = self.states
        if self.unit.estimated:
            own |= dict(zip(self.names, self.unit.get(self.names).tolist(), strict=True))
        return own | {"time": self.unit.time}

    def ledger(self) -> dict[str, Array]:
        """The unit's ledger of the last step; what it supplies to itself becomes the pair `inside`."""
        return self.booked(self.unit.ledger())

    def booked(self, book: dict[str, Array]) -> dict[str, Array]:
        """A ledger of the unit (.. x entries of each)."""
        if self._inside:
            inside = book["supplied"].sum(axis=-1, keepdims=True) - book["pairs"].sum(axis=-1, keepdims=True)
            book["pairs"] = np.concatenate([book["pairs"], inside], axis=-1)
        return book

    @property
    def events_told(self) -> UnitEventTexts:
        """Events within steps, as the unit tells them."""
        return self._event_texts

    def happened(self) -> list[StepEvent]:
        return self._event_texts.found

    def energies(self) -> Array:
        return self.unit.energies()

    def read(self) -> Array:
        """All columns; UnitFailure if an output of a foreign unit is not finite."""
        values = self.unit.get(self.names)
        if self._watched.size and not np.isfinite(values[self._watched]).all():
            names = [self.names[i] for i in self._watched]
            raise self.unit.steps.not_finite(names, values[self._watched], self.unit.time)
        return values

    def rest_changes(self) -> list[RestChange]:
        """A unit does not tell which of its constraints rest."""
        return []

    def check_start(self) -> None:
        """The unit refuses an inconsistent start itself, when it leaves initialisation."""
