"""Newton coupling: members stepped apart, joined by an interface Newton iteration on their step maps.

With xi the junction unknowns (common variables and dual inputs), U = P xi + U_free the port inputs and Y(U) the
step-conjugate outputs of a trial step from t_k, the interface equations are those of the composed model,

    r(xi) = P^T Y(P xi + U_free) + C xi = 0,     C skew,      dr/dxi = P^T G P + C,

with G = dY/dU of each member's step (implicit function theorem, or finite differences with rollback).  sym(G) > 0 makes
the matrix regular.  Whatever the iteration leaves is booked at the junctions: sum of h U^T Y over joined ports.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.junction_words import spread_words
from phfmu.engine.status import Status, StepFailure
from phfmu.network.couplings.stepper import Steps
from phfmu.network.junctions.compose import require_members
from phfmu.network.junctions.hidden import hidden_part
from phfmu.network.junctions.interface import interface
from phfmu.network.junctions.junction import Junction
from phfmu.network.junctions.network import Network
from phfmu.network.members.booking import Booking
from phfmu.network.members.consistent import MONOLITHIC, InconsistentState
from phfmu.network.members.differences import instant_sensitivity
from phfmu.network.members.member import Member
from phfmu.words import meant

Array = NDArray[Any]

ENERGY = 1e-14  # accepted interface energy relative to the energy in play
ROUNDING = 1e-13  # componentwise relative residual that counts as solved
COMPONENT = 1e-9  # largest one at which a stalled iteration counts as its rounding floor
FLOOR = 16.0  # units of rounding in a junction row that cannot be told from zero
ITERATIONS = 30


class Coupled:
    """Members coupled by interface Newton; the run loop drives it like a single model.

    Each junction unknown is one value per step, held: the whole is of order 2, whatever the order of the members is.
    """

    what, instead = "members stepped apart", "leave out --coupling newton, which composes them"

    def __init__(self, network: Network, members: list[Member]):
        require_members(network.name, network.members)
        self.network, self.members = network, members
        self._hidden: Array | None = None
        self.face = interface(network, members)
        self._slices = _stacked([m.nu for m in members])
        self.xi = self.face.start.copy()
        self._free = np.concatenate([m.start_inputs() for m in members])
        self._free[self.face.P.any(axis=1)] = 0.0
        self.names = [f"{m.name}.{n}" for m in members for n in m.names]
        self.names += self.face.names
        self.names += [f"constraint.sum.{n}" for n in self.face.sum_names()]
        at = {str(e): j.name for j in network.junctions for e in j.ends}
        components = tuple(c for m in members for c in m.booking.components)
        pairs = tuple(
            (c, p, i, at.get(f"{m.name}.{p}") if c == m.name else junction)
            for m in members for c, p, i, junction in m.booking.pairs
        )  # fmt: skip
        self.booking = Booking(components, pairs, frozenset(c for m in members for c in m.booking.estimated))
        self.iterations = 0
        self.accepted_by = ""

    # -- the stepper's side -----------------------------------------------------------------------------------------

    def settable(self) -> list[str]:
        return [f"{m.name}.{n}" for m in self.members for n in m.settable()]

    def set_value(self, name: str, value: float) -> str:
        """Set a member's parameter or free input `member.name` and say which it is; KeyError names close ones."""
        member, _, rest = name.partition(".")
        for m, place in zip(self.members, self._slices, strict=True):
            if m.name == member:
                self._hidden = None
                indices = [place.start + i for i in m.input_places(rest)]
                if indices:
                    if self.face.P[indices].any():
                        raise KeyError(f"{name} is fed by a junction; it cannot be set")
                    self._free[indices] = value
                    m.set_input(self._inputs()[place])
                    return "input"
                if m.set_parameter(rest, value):
                    return "parameter"
        raise KeyError(f"{self.network.name} has no parameter or input '{name}'; {meant(name, self.settable())}")

    def read(self) -> Array:
        parts = [m.read() for m in self.members]
        return np.concatenate([*parts, self.xi, self.end_sums()])

    def energies(self) -> Array:
        return np.concatenate([m.energies() for m in self.members])

    def end_sums(self) -> Array:
        """What the states violate at the present time, per common variable: the sum of the joined flows (efforts).

        A junction with dual inputs meets its sum by them; there it is the spread of the outputs that must be equal.
        Zero where outputs follow the junction unknowns.
        """
        y = np.concatenate([m.end_output() for m in self.members])
        r = self._hidden_rows() @ (self.face.P.T @ y + self.face.C @ self.xi)
        return np.array([r[own[0]] if len(own) == 1 else np.ptp(r[own]) for own in self.face.rows_of_sums()])

    def _hidden_rows(self) -> Array:
        """Projector to what no junction unknown can change, found anew after parameters were set."""
        if self._hidden is None:
            M, u = self.face.C.copy(), self._inputs()
            for m, place in zip(self.members, self._slices, strict=True):
                part = self.face.P[place]
                if part.any():
                    M += part.T @ instant_sensitivity(m, u[place]) @ part
            self._hidden = hidden_part(M, self.face.nominal)
        return self._hidden

    def check_start(self) -> None:
        """InconsistentState if joined flows (efforts) of states do not sum to zero."""
        for m in self.members:
            m.check_start()
        self._apply(self.xi)
        sums = self.end_sums()
        size = np.abs(self.face.P.T) @ np.abs(np.concatenate([m.end_output() for m in self.members]))
        bad = []
        joined = [j for j in self.network.junctions for _ in range(self.network.port_of(j.ends[0]).n)]
        for j, n, v, own in zip(joined, self.face.sum_names(), sums, self.face.rows_of_sums(), strict=True):
            if not abs(v) <= 1e-7 * (size[own].max() + 1e-6):
                pure = not self.face.C[own[0], : own[0]].any()
                bad.append(f"{n}: sum {v:.6g}" if pure else f"{n}: {self._differ(j, v)}")
        if bad:
            raise InconsistentState(
                f"{self.network.name}: inconsistent start: {'; '.join(bad)}. Joined flows of states must sum to zero "
                f"and joined outputs must be equal at the start; change the start values, or {MONOLITHIC}"
            )

    def _differ(self, junction: Junction, value: float) -> str:
        ports = {e: self.network.port_of(e) for e in junction.ends}
        shared = "effort" if junction.kind == "0" else "flow"
        givers = {str(e): p for e, p in ports.items() if p.given != shared}
        return spread_words(next(iter(givers.values())), tuple(givers), value)

    def project_start(self, t0: float, kept: Sequence[str] = ()) -> None:
        """Members know their own constraints only; ValueError tells how to start."""
        raise ValueError(
            f"{self.network.name}: a coupled network cannot be projected at t = {t0:g} s; use --coupling monolithic"
        )

    def prepare(self, t0: float, h: float) -> None:
        """Junction values before the first step: those of a trial step, then everything back."""
        states = [m.get_state() for m in self.members]
        try:
            self._solve(t0, h, states)
        finally:
            for m, s in zip(self.members, states, strict=True):
                m.set_state(s)
        self._apply(self.xi)

    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps:
        rows: list[tuple[Array, ...]] = []
        for k in range(n):
            try:
                now = self.step(t0 + (first + k) * h, h, lambda: (self.read(), self.energies()))
            except StepFailure as failure:
                failure.recorded = {"steps": Steps.stacked(rows)} if rows else {}
                raise
            books = [m.ledger() for m in self.members]
            parts = [np.concatenate([b[key] for b in books]) for key in ("stored", "dissipated", "supplied", "pairs")]
            damped = [b.get("numerical", np.zeros(len(b["stored"]))) for b in books]
            moved = [b.get("moved", np.abs(m.energies())) for m, b in zip(self.members, books, strict=True)]
            rows.append((*now, *parts, np.array(float(self.iterations)), np.concatenate(damped), np.concatenate(moved)))
        return Steps.stacked(rows)

    # -- one step ---------------------------------------------------------------------------------------------------

    def _inputs(self) -> Array:
        return self.face.P @ self.xi + self._free

    def _apply(self, xi: Array) -> None:
        u = self.face.P @ xi + self._free
        for m, place in zip(self.members, self._slices, strict=True):
            m.set_input(u[place])

    def step(self, t: float, h: float, read: Callable[[], Any] = lambda: None) -> Any:
        """One macro step, and what `read` finds at its end.

        Every member is at t + h with the committed inputs, or, also when reading fails, all are back at t.
        """
        states = [m.get_state() for m in self.members]
        xi = self.xi.copy()
        try:
            self._solve(t, h, states)
            return read()
        except BaseException:
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
        gain = np.zeros_like(face.C)
        for i in range(ITERATIONS):
            y = self._trial(xi, t, h, states, again=i > 0)
            r = face.P.T @ y + face.C @ xi
            if not np.isfinite(r).all():
                raise self._failure(Status.NOT_FINITE, t, h, r, y, xi, history)
            history.append(float(np.max(np.abs(r) / self._scale(y, xi), initial=0.0)))
            self.accepted_by = self._accepted(r, y, xi, h, history, gain)
            if self.accepted_by:
                self.xi, self.iterations = xi, i + 1
                return
            G = [m.sensitivity(t, h, s) for m, s in zip(self.members, states, strict=True)]
            matrix = face.C.copy()
            for g, place in zip(G, self._slices, strict=True):
                part = face.P[place]
                matrix += part.T @ g @ part
            gain = np.abs(matrix)
            scale = 1.0 / np.maximum(np.abs(matrix).max(axis=1), 1e-300)
            try:
                dxi = np.linalg.solve(matrix * scale[:, None], -r * scale)
            except np.linalg.LinAlgError:
                raise self._failure(Status.SINGULAR, t, h, r, y, xi, history) from None
            if not np.isfinite(dxi).all():
                raise self._failure(Status.NOT_FINITE, t, h, r, y, xi, history)
            xi = xi + dxi
        raise self._failure(Status.NO_CONVERGENCE, t, h, r, y, xi, history)

    def _scale(self, y: Array, xi: Array) -> Array:
        return np.abs(self.face.P.T) @ np.abs(y) + np.abs(self.face.C) @ np.abs(xi) + 1e-12 * self._floor()

    def _floor(self) -> Array:
        flow = np.abs(self.face.C) @ self.face.nominal
        return np.maximum(flow, 1e-3)

    def _accepted(self, r: Array, y: Array, xi: Array, h: float, history: list[float], gain: Array) -> str:
        """energy: interface energy below budget, every row at rounding; rounding floor: rows stopped shrinking.

        Rows of stiff members that hardly act stop at what a relative change of xi by eps makes of them.
        """
        energy = h * float(np.abs(xi) @ np.abs(r))
        in_play = max(float(np.abs(self.energies()).sum()), h * float(np.abs(self._inputs_at(xi)) @ np.abs(y)))
        stalled = len(history) > 2 and history[-1] > 0.5 * history[-2]
        if stalled and (np.abs(r) <= FLOOR * np.finfo(float).eps * (gain @ np.abs(xi))).all():
            return "rounding floor"
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
            tried=f"interface Newton (last scaled residuals {last}); all members are back at t", joined=True, history=history,
        )  # fmt: skip


def _stacked(sizes: list[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes])
    return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]
