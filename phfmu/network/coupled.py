"""Newton coupling: members stepped apart, joined by an interface Newton iteration on their step maps.

With xi the junction unknowns (common variables and dual inputs), U = P xi + U_free the port inputs and Y(U) the
step-conjugate outputs of a trial step from t_k, the interface equations are those of the composed model,

    r(xi) = P^T Y(P xi + U_free) + C xi = 0,     C skew,      dr/dxi = P^T G P + C,

with G = dY/dU of each member's step (implicit function theorem, or finite differences with rollback).  sym(G) > 0 makes
the matrix regular.  Whatever the iteration leaves is booked at the junctions: sum of h U^T Y over joined ports.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.status import Status, StepFailure
from phfmu.network.compose import junction_unknowns
from phfmu.network.members import Member
from phfmu.network.network import Network
from phfmu.network.stepper import Booking, InconsistentState, Steps

Array = NDArray[np.float64]

ENERGY = 1e-14  # accepted interface energy relative to the energy in play
ROUNDING = 1e-13  # componentwise relative residual that counts as solved
COMPONENT = 1e-9  # largest one at which a stalled iteration counts as its rounding floor
ITERATIONS = 30


@dataclass(frozen=True)
class Interface:
    """xi names and units, P (inputs x unknowns), C (skew), and which rows sum flows or efforts (Kirchhoff rows)."""

    names: list[str]
    P: Array
    C: Array
    start: Array
    nominal: Array
    sums: dict[str, slice]


def interface(network: Network, members: list[Member]) -> Interface:
    """The interface equations of `network` in the members' stacked external inputs."""
    offset, column = {}, 0
    for m in members:
        for port, place in m.places.items():
            offset[(m.name, port)] = np.arange(place.start, place.stop) + column
        column += m.nu
    names: list[str] = []
    start: list[float] = []
    nominal: list[float] = []
    entries: list[tuple[int, int]] = []
    skew: list[tuple[int, int]] = []
    sums = {}
    for j in network.junctions:
        u = junction_unknowns(network, j)
        common = len(names) + np.arange(u.common.n)
        sums[j.name] = slice(len(names), len(names) + u.common.n)
        for variable in (u.common, *u.dual.values()):
            names += variable.names()
            start += variable.start
            nominal += variable.nominal
        place = {end: common for end in j.ends}
        first = len(sums) and common[-1] + 1
        for end, variable in u.dual.items():
            place[end] = first + np.arange(variable.n)
            first += variable.n
            skew += list(zip(common, place[end], strict=True))
        for end, columns in place.items():
            entries += list(zip(offset[(end.member, end.port)], columns, strict=True))
    n = len(names)
    P, C = np.zeros((column, n)), np.zeros((n, n))
    for row, col in entries:
        P[row, col] = 1.0
    for c, d in skew:
        C[c, d], C[d, c] = 1.0, -1.0
    return Interface(names, P, C, np.array(start), np.array(nominal), sums)


class Coupled:
    """Members coupled by interface Newton; the run loop drives it like a single model."""

    def __init__(self, network: Network, members: list[Member]):
        self.network, self.members = network, members
        self.face = interface(network, members)
        self.xi = self.face.start.copy()
        self._free = np.concatenate([m.start_inputs() for m in members]) if members else np.zeros(0)
        self._free[self.face.P.any(axis=1)] = 0.0
        self._slices = _stacked([m.nu for m in members])
        self.names = [f"{m.name}.{n}" for m in members for n in m.names]
        self.names += self.face.names
        self.names += [f"constraint.sum.{n}" for n in self._sum_names()]
        at = {str(e): j.name for j in network.junctions for e in j.ends}
        components = tuple(c for m in members for c in m.booking.components)
        pairs = tuple(
            (c, p, i, at.get(f"{m.name}.{p}") if c == m.name else junction)
            for m in members for c, p, i, junction in m.booking.pairs
        )  # fmt: skip
        self.booking = Booking(components, pairs)
        self.iterations = 0
        self.accepted_by = ""

    def _sum_names(self) -> list[str]:
        return [self.face.names[i] for s in self.face.sums.values() for i in range(s.start, s.stop)]

    # -- the stepper's side -----------------------------------------------------------------------------------------

    def settable(self) -> list[str]:
        return [f"{m.name}.{n}" for m in self.members for n in m.settable()]

    def set_value(self, name: str, value: float) -> None:
        """Set a member's parameter or free input `member.name`; KeyError names close ones."""
        from difflib import get_close_matches

        member, _, rest = name.partition(".")
        for m, place in zip(self.members, self._slices, strict=True):
            if m.name == member:
                index = m.input_index(rest)
                if index is not None:
                    if self.face.P[place.start + index].any():
                        raise KeyError(f"{name} is fed by a junction; it cannot be set")
                    self._free[place.start + index] = value
                    m.set_input(self._inputs()[place])
                    return
                if m.set_parameter(rest, value):
                    return
        close = get_close_matches(name, self.settable(), 5)
        hint = f"; did you mean {', '.join(close)}?" if close else ""
        raise KeyError(f"{self.network.name} has no parameter or input '{name}'{hint}")

    def read(self) -> Array:
        parts = [m.read() for m in self.members]
        return np.concatenate([*parts, self.xi, self.end_sums()])

    def energies(self) -> Array:
        return np.concatenate([m.energies() for m in self.members])

    def end_sums(self) -> Array:
        """What the states violate at the present time, per common variable: the sum of the joined flows (efforts).

        A junction with dual inputs meets its sum by them; if no port takes the common variable (a rigid joint of
        masses), it is the spread of the outputs that must be equal.
        """
        y = self.face.P.T @ np.concatenate([m.end_output() for m in self.members])
        r = y + self.face.C @ self.xi
        out = []
        for i in (i for s in self.face.sums.values() for i in range(s.start, s.stop)):
            dual = np.flatnonzero(self.face.C[i])
            if not dual.size:
                out.append(r[i])
            else:
                out.append(0.0 if self.face.P[:, i].any() else float(np.ptp(y[dual])))
        return np.array(out)

    def check_start(self) -> None:
        """InconsistentState if joined flows (efforts) of states do not sum to zero."""
        for m in self.members:
            m.check_start()
        self._apply(self.xi)
        sums = self.end_sums()
        y = np.concatenate([m.end_output() for m in self.members])
        rows = [i for s in self.face.sums.values() for i in range(s.start, s.stop)]
        scale = (np.abs(self.face.P.T) @ np.abs(y))[rows] + 1e-6
        bad = [f"{n}: sum {v:.6g}" for n, v, s in zip(self._sum_names(), sums, scale, strict=True) if abs(v) > 1e-7 * s]
        if bad:
            raise InconsistentState(
                f"{self.network.name}: inconsistent start: {'; '.join(bad)}. The joined flows must sum to zero at the "
                "start; change the start values"
            )

    def prepare(self, t0: float, h: float) -> None:
        """Junction values before the first step: those of a trial step, then everything back."""
        states = [m.get_state() for m in self.members]
        self._solve(t0, h, states)
        for m, s in zip(self.members, states, strict=True):
            m.set_state(s)
        self._apply(self.xi)

    def advance(self, t0: float, h: float, n: int) -> Steps:
        rows: list[tuple[Array, ...]] = []
        for k in range(n):
            try:
                self.step(t0 + k * h, h)
            except StepFailure as failure:
                failure.recorded = {"steps": Steps.stacked(rows)} if rows else {}
                raise
            books = [m.ledger() for m in self.members]
            parts = [np.concatenate([b[key] for b in books]) for key in ("stored", "dissipated", "supplied", "pairs")]
            rows.append((self.read(), self.energies(), *parts, np.array(float(self.iterations))))
        return Steps.stacked(rows)

    # -- one step ---------------------------------------------------------------------------------------------------

    def _inputs(self) -> Array:
        return self.face.P @ self.xi + self._free

    def _apply(self, xi: Array) -> None:
        u = self.face.P @ xi + self._free
        for m, place in zip(self.members, self._slices, strict=True):
            m.set_input(u[place])

    def step(self, t: float, h: float) -> None:
        """One macro step; every member is at t + h with the committed inputs, or all are back at t."""
        states = [m.get_state() for m in self.members]
        xi = self.xi.copy()
        try:
            self._solve(t, h, states)
        except StepFailure:
            for m, s in zip(self.members, states, strict=True):
                m.set_state(s)
            self.xi = xi
            raise

    def _trial(self, xi: Array, t: float, h: float, states: list[Any], again: bool) -> Array:
        if again:
            for m, s in zip(self.members, states, strict=True):
                m.set_state(s)
        self._apply(xi)
        for m in self.members:
            m.do_step(t, h)
        return np.concatenate([m.output() for m in self.members])

    def _solve(self, t: float, h: float, states: list[Any]) -> None:
        face, xi = self.face, self.xi.copy()
        history: list[float] = []
        for i in range(ITERATIONS):
            y = self._trial(xi, t, h, states, again=i > 0)
            r = face.P.T @ y + face.C @ xi
            if not np.isfinite(r).all():
                raise self._failure(Status.NOT_FINITE, t, h, r, y, xi, history)
            history.append(float(np.max(np.abs(r) / self._scale(y, xi), initial=0.0)))
            self.accepted_by = self._accepted(r, y, xi, h, history)
            if self.accepted_by:
                self.xi, self.iterations = xi, i + 1
                return
            G = [m.sensitivity(t, h, s) for m, s in zip(self.members, states, strict=True)]
            matrix = face.C.copy()
            for g, place in zip(G, self._slices, strict=True):
                part = face.P[place]
                matrix += part.T @ g @ part
            scale = 1.0 / np.maximum(np.abs(matrix).max(axis=1), 1e-300)
            try:
                dxi = np.linalg.solve(matrix * scale[:, None], -r * scale)
            except np.linalg.LinAlgError:
                raise self._failure(Status.SINGULAR, t, h, r, y, xi, history) from None
            xi = xi + dxi
        raise self._failure(Status.NO_CONVERGENCE, t, h, r, y, xi, history)

    def _scale(self, y: Array, xi: Array) -> Array:
        return np.abs(self.face.P.T) @ np.abs(y) + np.abs(self.face.C) @ np.abs(xi) + 1e-12 * self._floor()

    def _floor(self) -> Array:
        flow = np.abs(self.face.C) @ self.face.nominal
        return np.maximum(flow, 1e-3)

    def _accepted(self, r: Array, y: Array, xi: Array, h: float, history: list[float]) -> str:
        """ "energy": interface energy below budget and every row at rounding; "rounding floor": rows stopped shrinking."""
        energy = h * float(np.abs(xi) @ np.abs(r))
        in_play = max(float(np.abs(self.energies()).sum()), h * float(np.abs(self._inputs_at(xi)) @ np.abs(y)))
        stalled = len(history) > 2 and history[-1] > 0.5 * history[-2]
        if energy > ENERGY * in_play and not (stalled and energy <= 10 * ENERGY * in_play):
            return ""
        if history[-1] <= ROUNDING:
            return "energy"
        return "rounding floor" if stalled and history[-1] <= COMPONENT else ""

    def _inputs_at(self, xi: Array) -> Array:
        return self.face.P @ xi + self._free

    def _failure(
        self, status: Status, t: float, h: float, r: Array, y: Array, xi: Array, history: list[float]
    ) -> StepFailure:
        worst = int(np.argmax(np.nan_to_num(np.abs(r) / self._scale(y, xi), nan=np.inf)))
        last = ", ".join(f"{v:.3g}" for v in history[-3:])
        return StepFailure(
            status, self.network.name, t, h, equation=f"junction row of {self.face.names[worst]} = {xi[worst]:.6g}",
            residual=float(abs(r[worst])), iterations=len(history),
            tried=f"interface Newton (last scaled residuals {last}); all members are back at t",
        )  # fmt: skip


def _stacked(sizes: list[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes])
    return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]
