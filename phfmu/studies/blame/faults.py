"""Faults of one member, or of one of its connections, planted by a member that stands around it.

A fault sits on one signal of one port, an input or an output, or it is a damper of negative size inside.  The member's books are
of three kinds: they are kept inside of the fault (`CONNECTION`: what is wrong is between member and junction), outside of it
(`MEMBER`: the ledger is made of the signals that the member tells), or there are none (`UNBOOKED`), as of a unit of another tool,
whose port energy is the trapezoid of its outputs under the inputs that it is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.booking import Booking, PortKey
from phfmu.audit.kinds import Quality
from phfmu.network.members.engine_member import EngineMember

Array = NDArray[np.float64]


class FaultKind(StrEnum):
    """Kinds of faults."""

    GAIN = "gain"
    UNIT = "unit factor"
    SIGN = "sign"
    DELAY = "delay"
    LOST = "lost samples"
    QUANTISED = "quantised output"
    DAMPER = "negative damper"


class FaultPlace(StrEnum):
    """The place of a fault, by what the books of the member say of it."""

    CONNECTION = "connection"
    MEMBER = "member with books"
    UNBOOKED = "member without books"


#: kinds that are a constant factor on a signal
FACTORS = (FaultKind.GAIN, FaultKind.UNIT, FaultKind.SIGN)


@dataclass(frozen=True)
class PlantedFault:
    """A fault of the signal number `pair` of the ports of a member, on its input (`given`) or its output.

    size:  the factor of GAIN, UNIT and SIGN; the steps of DELAY; the quantum of QUANTISED; of DAMPER the factor on `parameter`
    lost:  numbers of the steps before which the input is not updated
    """

    kind: FaultKind
    pair: int = 0
    given: bool = False
    size: float = 1.0
    lost: frozenset[int] = frozenset()
    parameter: str = ""


@dataclass(frozen=True)
class SignalHistory:
    """The memory of a faulty signal over the steps so far: values given, values used, outputs at ends, means."""

    given: tuple[float, ...] = ()
    used: float = 0.0
    ends: tuple[float, ...] = ()
    means: tuple[float, ...] = ()
    steps: int = 0


class FaultyMember:
    """The member `inner` with a fault, or None, and with books or without; whatever else it is asked, `inner` answers.

    W:  energy through the ports as it is told [J], from the start to the end of each step
    had:  energy stored at the start;  gross:  sum of |energy| of the ports;  made:  of it what the fault made, the sum of
    |energy that is told - energy that the member took|
    """

    saves, finishes = True, False

    def __init__(self, inner: EngineMember, fault: PlantedFault | None, where: FaultPlace):
        self.inner, self.where = inner, where
        if fault and fault.kind is FaultKind.DAMPER:
            p = inner.instance.parameters.copy()
            p[inner.parameter_places([fault.parameter])] *= fault.size
            inner.instance.set_parameters(p)
            fault = None
        self.fault, self._past = fault, SignalHistory()
        self._u = inner.start_inputs()
        self._mean: Array | None = None
        self._pairs, self.W = np.zeros(inner.nu), [0.0]
        self.made, self.gross, self.had = 0.0, 0.0, float(inner.energies().sum())
        self.booking = _unbooked(inner) if where is FaultPlace.UNBOOKED else inner.booking

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    # -- signals ----------------------------------------------------------------------------------------------------

    def _inside(self, u: Array) -> Array:
        """The inputs that the member takes when it is given u."""
        f, past = self.fault, self._past
        if f is None or not f.given:
            return u
        u, value = u.copy(), float(u[f.pair])
        if f.kind in FACTORS:
            u[f.pair] = f.size * value
        elif f.kind is FaultKind.DELAY:
            u[f.pair] = _earlier(past.given, int(f.size), value)
        elif f.kind is FaultKind.LOST and past.steps in f.lost:
            u[f.pair] = past.used
        return u

    def _told(self, y: Array, before: Sequence[float], off: float) -> Array:
        """The outputs that it tells; `before`: those of earlier steps;  off: by how much the rounding is off."""
        f = self.fault
        if f is None or f.given:
            return y
        y, value = y.copy(), float(y[f.pair])
        if f.kind in FACTORS:
            y[f.pair] = f.size * value
        elif f.kind is FaultKind.DELAY:
            y[f.pair] = _earlier(tuple(before), int(f.size), value)
        elif f.kind is FaultKind.QUANTISED:
            y[f.pair] = value + off
        return y

    def _off(self, y: Array) -> float:
        f = self.fault
        if f is None or f.given or f.kind is not FaultKind.QUANTISED:
            return 0.0
        return float(f.size * np.round(y[f.pair] / f.size) - y[f.pair])

    def set_input(self, u: Array) -> None:
        self._u = u.copy()
        self.inner.set_input(self._inside(u))

    def begin(self, u: Array) -> None:
        self._u = u.copy()
        self.inner.begin(self._inside(u))

    def do_step(self, t: float, h: float) -> None:
        past, f, u = self._past, self.fault, self._inside(self._u)
        start = self.inner.end_output().copy()
        before = self._told(start, past.ends, self._off(start))
        self.inner.set_input(u)
        self.inner.do_step(t, h)
        mean, end = self.inner.output().copy(), self.inner.end_output().copy()
        ends = (*past.ends, float(start[f.pair])) if f else ()
        if self.where is FaultPlace.UNBOOKED:
            # outputs at both ends; a rounding that jumps within a step would leave nothing to iterate for
            self._mean = 0.5 * (before + self._told(end, ends, self._off(start)))
        else:
            self._mean = self._told(mean, past.means, self._off(start))
        true, self._pairs = h * u * mean, h * self._u * self._mean
        self.W.append(self.W[-1] + float(self._pairs.sum()))
        self.made += float(np.abs(self._pairs - true).sum())
        self.gross += float(np.abs(self._pairs).sum())
        if f:
            keep = int(f.size) + 1 if f.kind is FaultKind.DELAY else 1
            given = (*past.given, float(self._u[f.pair]))[-keep:]
            means = (*past.means, float(mean[f.pair]))[-keep:]
            self._past = SignalHistory(given, float(u[f.pair]), ends[-keep:], means, past.steps + 1)

    def output(self) -> Array:
        return self.inner.output() if self._mean is None else self._mean

    def end_output(self) -> Array:
        y = self.inner.end_output()
        return self._told(y, self._past.ends, self._off(y))

    def sensitivity(self) -> Array:
        G, f = self.inner.sensitivity().copy(), self.fault
        if f is None or f.kind is FaultKind.QUANTISED:
            return G
        change = f.size if f.kind in FACTORS else 0.0
        if f.kind is FaultKind.LOST and (self._past.steps - 1) not in f.lost:
            change = 1.0
        if f.given:
            G[:, f.pair] *= change
        else:
            G[f.pair] *= change
        return G

    # -- states and books -------------------------------------------------------------------------------------------

    def get_state(self) -> Any:
        own = len(self.W), self._past, self.made, self.gross, self._mean, self._pairs, self._u
        return self.inner.get_state(), own

    def set_state(self, state: Any) -> None:
        inner, own = state
        self.inner.set_state(inner)
        steps, self._past, self.made, self.gross, self._mean, self._pairs, self._u = own
        del self.W[steps:]

    def energies(self) -> Array:
        return np.array([self.W[-1]]) if self.where is FaultPlace.UNBOOKED else self.inner.energies()

    def ledger(self) -> dict[str, Array]:
        if self.where is FaultPlace.UNBOOKED:
            supplied = np.array([self._pairs.sum()])
            return {"stored": supplied, "dissipated": np.zeros(1), "supplied": supplied, "pairs": self._pairs.copy()}
        book = self.inner.ledger()
        if self.where is FaultPlace.MEMBER and self.fault:
            book = dict(book)
            pairs = book["pairs"].copy()
            column = _columns(self.inner)[self.fault.pair]
            book["supplied"] = book["supplied"] + self._pairs[self.fault.pair] - pairs[column]
            pairs[column] = self._pairs[self.fault.pair]
            book["pairs"] = pairs
        return book


def _earlier(values: tuple[float, ...], steps: int, now: float) -> float:
    """The value so many steps ago, or the first one; there is none yet: the present one."""
    return values[max(len(values) - steps, 0)] if values else now


def _columns(member: EngineMember) -> list[int]:
    """Columns of the pairs of a member that are its inputs, in their order."""
    ports = [k.port for k in member.booking.ports]
    return [ports.index(name) for name in member.places]


def _unbooked(member: EngineMember) -> Booking:
    """Booking of a member without books, like a unit of another tool: its free ports, estimated."""
    return Booking((member.name,), tuple(PortKey(member.name, p, quality=Quality.ESTIMATED) for p in member.places))
