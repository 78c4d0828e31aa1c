"""The books of a run: its steps and events in the ledger, and the worst of its hidden constraints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.couplings.acceptance import HALVED, KEPT
from phfmu.network.couplings.stepper import Stepper
from phfmu.network.members.consistent import InconsistentState
from phfmu.network.scene import Event
from phfmu.outcome.status import EndRequested, StepFailure
from phfmu.outcome.steps import StepEvent, Steps
from phfmu.signals import CONSTRAINT
from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.audit import Ledger
    from phfmu.audit.booking import Booking
    from phfmu.audit.null_ledger import NullLedger
    from phfmu.discretise.start import Projection

Array = NDArray[Any]


class Book:
    """Books the steps of a stepper in a ledger and watches the hidden constraints; `tell` gets time and text of state events."""

    CARRIED = ("steps", "iterations", "_worst", "_H", "least", "_least", "notes", "given_up")

    def __init__(self, stepper: Stepper, ledger: Ledger | NullLedger, tell: Callable[[float, str], None] | None = None):
        self.stepper, self.ledger = stepper, ledger
        self._tell = tell
        self.steps, self.iterations = 0, 0.0
        #: start and length of the last step
        self.last = 0.0, 0.0
        self._watch = [(n, i) for i, n in enumerate(stepper.names) if n.startswith(CONSTRAINT)]
        self._worst = dict.fromkeys((n for n, _ in self._watch), 0.0)
        self._H = np.zeros(0)
        #: component -> time and signals at the end of its step that dissipated least, where that was negative
        self.least: dict[str, tuple[float, Array]] = {}
        self._least = np.zeros(len(self.booking.components))
        #: what the events did beside setting values, one line each
        self.notes: list[str] = []
        #: steps that a coupling kept without convergence, and that it halved
        self.given_up: dict[str, int] = dict.fromkeys((KEPT, HALVED), 0)

    @property
    def booking(self) -> Booking:
        """The booking of the stepper, which damping steps may give more parts."""
        return self.stepper.booking

    def start(self) -> None:
        self._H = self.stepper.energies()

    def set_value(self, e: Event) -> None:
        """Set an event's value and book the energy that a changed parameter makes or takes."""
        kind = self.stepper.set_value(e.name, e.value)
        message, now = _message(e), self.stepper.energies()
        changed = self._changed(self._H, now)
        for component, jump in changed:
            self.ledger.event(e.t, kind, component, jump, message)
        if not changed:
            self.ledger.event(e.t, kind, message=message)
        self._H = now
        if changed:
            self._keep_consistent(e)

    def happened(self, e: StepEvent) -> None:
        """Book state events: what a jump added to the energy of each component, and what it lost."""
        rows = [(c, float(j), float(x)) for c, j, x in zip(self.booking.components, e.energy, e.lost, strict=True)]
        changed = [row for row in rows if row[1] or row[2]]
        for component, energy, lost in changed:
            self.ledger.event(e.t, e.kind, component, energy, e.message, lost)
        if not changed:
            self.ledger.event(e.t, e.kind, message=e.message)
        self._H = self._H + e.energy
        if self._tell is not None:
            self._tell(e.t, e.message)
        lost = float(e.lost.sum())
        self.notes.append(f"t = {e.t:.12g} s: {e.names}" + (f", lost {lost:.9g} J" if lost else ""))

    def as_near(self, row: Array) -> bool:
        """Whether a row is as near to the hidden constraints as the steps so far were.

        Currents that are given over time at a node of inductances hold in the mean of steps, and at their ends to their order.
        """
        return bool(self._watch) and all(abs(row[i]) <= self._worst[name] for name, i in self._watch)

    def inputs(self, changes: Sequence[tuple[int, Event]]) -> None:
        """Book free inputs that changed between steps; they change no energy."""
        for _, e in changes:
            self.ledger.event(e.t, "input", message=_message(e))

    def _keep_consistent(self, e: Event) -> None:
        """A parameter that enters a hidden constraint (an inductance at a node) makes the state jump as by an impulse."""
        try:
            self.stepper.check_changed()
        except InconsistentState:
            found = self.project(e.t, (), self._owner(e.name))
            self.stepper.check_changed()
            self._H = self.stepper.energies()
            if found is not None:
                self.notes.append(
                    f"projected at t = {e.t:g} s: {e.name} = {e.value:g} left hidden constraints violated; energy changed by "
                    f"{found.energy:.9g} J, moved {', '.join(found.moves())}"
                )

    def project(self, t0: float, kept: Sequence[str], owner: str | None = None) -> Projection | None:
        """Move the start onto its constraints; the energy change of each component is an event.

        owner: component that dissipates what the impulses lose (whose parameter changed); None: the start was not so before.
        """
        before = self.stepper.energies()
        found = self.stepper.project_start(t0, kept)
        if found is None or not found.moved:
            return found
        changed = self._named(found.changes) if found.changes else dict(self._changed(before, self.stepper.energies()))
        rows = {c: (jump, 0.0) for c, jump in changed.items()}
        if owner is not None and found.lost:
            rows[owner] = changed.get(owner, 0.0), found.lost
        for component, (jump, lost) in (rows or {None: (0.0, 0.0)}).items():
            self.ledger.event(t0, "reprojection", component, jump, ", ".join(found.moves()), lost or None)
        return found

    def _named(self, changes: Sequence[float]) -> dict[str | None, float]:
        """Components with a change of their energy."""
        return {c: d for c, d in zip(self.booking.components, changes, strict=True) if d}

    def _owner(self, name: str) -> str:
        """The component that has the parameter `name`."""
        begins = [c for c in self.booking.components if name.startswith(f"{c}.")]
        return max(begins, key=len, default=self.booking.components[0])

    def _changed(self, before: Array, after: Array) -> list[tuple[str | None, float]]:
        """Components whose energy differs, and by how much."""
        return [(c, float(d)) for c, d in zip(self.booking.components, after - before, strict=True) if d]

    def failed(self, failure: StepFailure) -> None:
        """Book that the run ends here, and bring everything to the file; nothing of an end that was asked for."""
        if isinstance(failure, EndRequested):
            return
        self.ledger.event(failure.time, "nonconverged", failure.component, message=str(failure))
        self.ledger.flush()

    def add(self, t: Array, h: Array, s: Steps) -> None:
        """Book n accepted steps that start at t (n) and have the sizes h (n), and what happened in them.

        A step is one row: what happened in its first half comes before it, the rest after it, as a log is read again.
        """
        first = 0
        for i, inside in groupby(s.events, key=itemgetter(0)):
            events = [e for _, e in inside]
            middle = t[i] + 0.5 * h[i]
            later = [e for e in events if e.t > middle]
            self._add(t[first:i], h[first:i], s.part(first, i))
            for e in events[: len(events) - len(later)]:
                self.happened(e)
            part = s.part(i, i + 1)
            self._add(t[i : i + 1], h[i : i + 1], replace(part, H=part.H - sum(e.energy for e in later)))
            for e in later:
                self.happened(e)
            first = i + 1
        self._add(t[first:], h[first:], s.part(first, len(s.H)) if first else s)

    def _add(self, t: Array, h: Array, s: Steps) -> None:
        n = len(s.H)
        if n == 0:
            return
        k = self.steps + np.arange(n)
        before = np.vstack([self._H[None], s.H[:-1]])
        self._H = s.H[-1]
        numerical = s.numerical if s.numerical is not None and s.numerical.any() else None
        self.ledger.add(self.booking, k, t, h, replace(s, numerical=numerical), before)
        self.steps, self.last = self.steps + n, (float(t[-1]), float(h[-1]))
        self.iterations += s.spent
        self._keep_least(t, h, s)
        self._keep_given_up(t, s)
        for name, i in self._watch:
            self._worst[name] = max(self._worst[name], float(np.max(np.abs(s.signals[:, i]))))

    def _keep_least(self, t: Array, h: Array, s: Steps) -> None:
        if s.dissipated.min(initial=0.0) >= 0.0:
            return
        least = s.dissipated.min(axis=0)
        for c in np.flatnonzero(least < self._least):
            i = int(np.argmin(s.dissipated[:, c]))
            self._least[c] = least[c]
            self.least[self.booking.components[c]] = float(t[i] + h[i]), s.signals[i].copy()

    def _keep_given_up(self, t: Array, s: Steps) -> None:
        if s.accepted_by is None:
            return
        for word, message in (KEPT, "the best trial was kept"), (HALVED, "taken in parts"):
            for i in np.flatnonzero(s.accepted_by == word):
                self.given_up[word] += 1
                self.ledger.event(float(t[i]), word, message=message)

    def told(self) -> list[str]:
        """Lines about steps whose iteration was given up."""
        kept, halved = self.given_up[KEPT], self.given_up[HALVED]
        lines = [f"{counted(halved, 'step')} of {self.steps} did not converge and went in parts"] if halved else []
        if kept:
            many = f"{counted(kept, 'step')} of {self.steps}"
            lines.append(f"{many} did not converge; the best trial was kept, and its junctions made energy")
        return lines

    def worst(self) -> dict[str, float]:
        return self._worst


def _message(e: Event) -> str:
    return f"{e.name} = {e.value:.9g}"
