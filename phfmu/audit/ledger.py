"""The energy ledger: compensated sums of what was stored, dissipated and supplied, and what does not close.

Per step (power positive INTO the component)

    component:  residual    = dH + dissipated + numerical - supplied
    junction:   residual    = sum of the supplied energies of its member ports
    network:    unexplained = (sum dH + sum dissipated + sum numerical - external) - sum of junction residuals

`numerical` is the loss of a damping scheme (Radau IIA restart steps); absent elsewhere.
`external` is what ports without a junction supplied. A component without a row of its own (a foreign FMU that
reports no energy) lies outside the balance: what it takes from a junction leaves through `external`.

A sink takes its rows.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike

from phfmu.audit.booked_steps import BookedSteps, book_steps
from phfmu.audit.booking import Booking, TermKey
from phfmu.audit.events import EventCount, EventRow
from phfmu.audit.judge import DEFAULT_RTOL, Judge
from phfmu.audit.kinds import Quality
from phfmu.audit.summary import (
    ComponentSummary,
    JunctionSummary,
    LedgerSummary,
    NetworkSummary,
    PartSummary,
    PortSummary,
    TermSummary,
)
from phfmu.audit.summing.run_sums import RunSums
from phfmu.audit.summing.sums import Floats, compiled, ratio, use_compiled
from phfmu.audit.violation import COMPONENT, JUNCTION, NETWORK, Violation, word
from phfmu.outcome.steps import Steps
from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.audit.summing.ordinary import Ordinary


class Sink(Protocol):
    """Receiver of rows while the run is under way; `AuditWriter` is one."""

    def write_steps(self, block: BookedSteps) -> None: ...

    def write_event(self, event: EventRow) -> None: ...

    def flush(self) -> None: ...


#: numbers to add up and to judge after which a compiled library is worth its start, a few milliseconds
LONG = 1 << 16
#: of them for each component, beside one for each port pair
COLUMNS = 8


class Ledger:
    """Adds up the steps of a run, judges them, and hands them to an optional sink.

    The sums are the same, bit for bit, however the steps are cut into blocks. `rtol`: allowed residual relative to the
    energies in play, see `Judge`.
    """

    CARRIED = ("_judge", "_sums", "_steps", "_t_start", "_t_end", "_events")

    def __init__(self, sink: Sink | None = None, rtol: float = DEFAULT_RTOL) -> None:
        self._sink = sink
        self._judge = Judge(rtol)
        self._sums = RunSums()
        self._ordinary: Ordinary | None = None
        self._steps = self._numbers = 0
        self._t_start = self._t_end = math.nan
        self._events = EventCount()

    def __repr__(self) -> str:
        return f"<Ledger: {counted(self._steps, 'step')}, {self._t_start:g} to {self._t_end:g} s>"

    def _repr_html_(self) -> str:
        """For notebooks: the tables that `phfmu run` prints."""
        from phfmu.audit.tables.report import audit_html

        return audit_html(self.summary())

    def add(
        self,
        booking: Booking,
        step: ArrayLike,
        t0: ArrayLike,
        h: ArrayLike,
        steps: Steps,
        H0: ArrayLike | None = None,
    ) -> None:
        """Book n accepted steps; shapes and errors as for `book_steps`, which copies the arrays."""
        self._change_over(steps)
        if self._sink is None and self._ordinarily(booking, step, t0, h, steps, H0):
            if steps.terms is not None:
                self._sums.add_terms(booking.terms, steps.terms)
            return
        block = book_steps(booking, step, t0, h, steps, H0)
        if len(block.step) == 0:
            return
        block = self._taken(block)
        if self._sink is not None:
            self._sink.write_steps(block)

    def take(self, block: BookedSteps) -> BookedSteps:
        """Sum and judge a block of at least one step; the block with what only the run knows filled in."""
        self._change_over(block.steps)
        return self._taken(block)

    def _taken(self, block: BookedSteps) -> BookedSteps:
        stored = self._sums.add(block)
        relative = self._judge.steps(block, stored)
        self._count(block.t0, block.h)
        return replace(block, relative=relative)

    def _change_over(self, s: Steps) -> None:
        """To compiled code, when it begins to pay."""
        self._numbers, before = self._numbers + np.size(s.pairs) + COLUMNS * np.size(s.stored), self._numbers
        if before < LONG <= self._numbers:
            use_compiled()

    def _ordinarily(
        self, booking: Booking, step: ArrayLike, t0: ArrayLike, h: ArrayLike, steps: Steps, H0: ArrayLike | None
    ) -> bool:
        """Sum and judge steps in one pass of compiled code, if they are ordinary."""
        library, numbers, start, size = compiled(), *(np.asarray(x) for x in (step, t0, h))
        if library is None or not numbers.shape == start.shape == size.shape == (len(steps.H),):
            return False
        own = self._ordinary
        if own is None or own.booking is not booking:
            from phfmu.audit.summing.ordinary import Ordinary

            own = self._ordinary = Ordinary(library, booking, self._sums, self._judge)
        worst = own.take(steps, H0)
        if worst is None:
            return False
        for name, row in zip(booking.components, worst, strict=True):
            if row >= 0:
                account = self._judge.accounts[name]
                account.worst_step, account.worst_t0 = int(numbers[row]), float(start[row])
        self._count(start, size)
        return True

    def _count(self, t0: Floats, h: Floats) -> None:
        if self._steps == 0:
            self._t_start = float(t0[0])
        self._steps += len(t0)
        self._t_end = float(t0[-1] + h[-1])

    def event(
        self,
        t: float,
        kind: str,
        component: str | None = None,
        energy_jump: float | None = None,
        message: str | None = None,
        lost: float | None = None,
    ) -> None:
        """Book something between the last step and the next.

        energy_jump [J]: what it added to the component's H;  lost [J]: what a jump of the states lost there.
        """
        self._events.add(t, kind, component, message)
        if component is not None and energy_jump is not None:
            self._sums.by["jumps", component].add(energy_jump)
            self._judge.jump(component, energy_jump)
        if self._sink is not None:
            self._sink.write_event(EventRow(t, kind, component, energy_jump, message, lost))

    def terms(self, keys: Sequence[TermKey], values: Floats) -> None:
        """Book what terms stored or lost (n x terms) in steps that are booked by themselves, as a log has them."""
        self._sums.add_terms(keys, values)

    def contradiction(self, violation: Violation) -> None:
        """Book that rows of a file contradict each other."""
        self._judge.note(violation)

    def flush(self) -> None:
        """Bring everything booked so far to the sink's file; call it before raising an error."""
        if self._sink is not None:
            self._sink.flush()

    def summary(self) -> LedgerSummary:
        """The sums so far and the verdict on them, as plain values."""
        found = self._judge.violations(self._sums.by.get("unexplained") or 0.0)
        return LedgerSummary(
            self._steps,
            self._t_start,
            self._t_end,
            [self._component(name, found) for name in self._judge.accounts],
            [
                PortSummary(*key, *kept, self._sums.by.get("port", *key) or 0.0)
                for key, kept in self._sums.ports.items()
            ],
            [self._junction(name, worst, found) for name, worst in self._sums.junctions.items()],
            [
                PartSummary(key.junction, key.part, self._sums.by.get("part", key.junction, key.part) or 0.0, worst)
                for key, worst in self._sums.parts.items()
            ],
            [
                TermSummary(
                    key.component, key.term, key.stores, self._sums.by.get("term", key.component, key.term) or 0.0
                )
                for key in self._sums.terms
            ],
            self._network(found) if self._steps else None,
            dict(self._events.kinds),
            self._judge.rtol,
            found,
        )

    def _component(self, name: str, found: list[Violation]) -> ComponentSummary:
        get, account = self._sums.by.get, self._judge.accounts[name]
        return ComponentSummary(
            name,
            account.H_start,
            account.H_end,
            stored=get("stored", name) or 0.0,
            dissipated=get("dissipated", name) or 0.0,
            supplied=get("supplied", name) or 0.0,
            jumps=get("jumps", name),
            worst_residual=account.worst_residual,
            worst_ratio=account.worst_ratio,
            worst_relative=self._judge.rtol * account.worst_ratio,
            worst_step=account.worst_step,
            worst_t0=account.worst_t0,
            gap=account.gap.value,
            verdict=word(found, COMPONENT, name, account.quality),
            numerical=get("numerical", name),
            run_ratio=float(ratio(account.missed.value, account.allowed)),
            gross=get("gross", name) if self._sums.ports else None,
        )

    def _junction(self, name: str, worst: float, found: list[Violation]) -> JunctionSummary:
        get, sums = self._sums.by.get, self._sums
        quality = (
            Quality.LOOSE if name in sums.loose else Quality.ESTIMATED if name in sums.estimated else Quality.EXACT
        )
        verdict = word(found, JUNCTION, name, quality)
        made, gross = get("junction", name) or 0.0, get("created", name) or 0.0
        return JunctionSummary(name, made, get("exchanged", name), worst, verdict, gross)

    def _network(self, found: list[Violation]) -> NetworkSummary:
        get = self._sums.by.get
        return NetworkSummary(
            stored=get("dH") or 0.0,
            dissipated=get("dissipated") or 0.0,
            external=get("external"),
            junction_residual=get("junction_residual"),
            unexplained=get("unexplained") or 0.0,
            worst_unexplained=self._sums.unexplained,
            verdict=word(found, NETWORK, "network", self._judge.quality),
            numerical=get("numerical"),
        )
