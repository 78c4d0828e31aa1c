"""The energy ledger: compensated sums of what was stored, dissipated and supplied, and what does not close.

Per step (power positive INTO the component)

    component:  residual    = dH + dissipated + numerical - supplied
    junction:   residual    = sum of the supplied energies of its member ports
    network:    unexplained = (sum dH + sum dissipated + sum numerical - external) - sum of junction residuals

`numerical` is the loss of a damping scheme (Radau IIA restart steps); absent elsewhere.
`external` is what ports without a junction supplied. A component without a row of its own (a foreign FMU that
reports no energy) lies outside the balance: what it takes from a junction leaves through `external`.
"""

import math
from dataclasses import replace
from html import escape

import numpy as np
from numpy.typing import ArrayLike

from phfmu.engine.steps import Steps
from phfmu.words import counted

from .block import Block, make_block
from .booking import Booking, PartKey
from .events import EventCount, EventRow
from .judge import DEFAULT_RTOL, Judge
from .kinds import Quality
from .sink import Sink
from .summary import ComponentSummary, JunctionSummary, LedgerSummary, NetworkSummary, PartSummary, PortSummary
from .sums import Floats, Sums, larger, largest, use_compiled
from .violation import COMPONENT, JUNCTION, Violation, ViolationKind, word

#: columns of the network that have running sums beside them
CUMULATIVE = ("dissipated", "external", "junction_residual", "unexplained")


#: numbers to add up after which sums are worth a compiled library
LONG = 1 << 17


class Ledger:
    """Adds up the steps of a run, judges them, and hands them to an optional sink.

    The sums are the same, bit for bit, however the steps are cut into blocks. `rtol`: allowed residual relative to the
    energies in play, see `Judge`.
    """

    def __init__(self, sink: Sink | None = None, rtol: float = DEFAULT_RTOL) -> None:
        self._sink = sink
        self._judge = Judge(rtol)
        self._sums = Sums()
        self._ports: dict[tuple[str, str], tuple[str | None, Quality]] = {}
        self._junctions: dict[str, float] = {}
        self._parts: dict[PartKey, float] = {}
        self._estimated: set[str] = set()
        self._loose: set[str] = set()
        self._unexplained = 0.0
        self._steps = self._numbers = 0
        self._t_start = self._t_end = math.nan
        self._events = EventCount()

    def __repr__(self) -> str:
        return f"<Ledger: {counted(self._steps, 'step')}, {self._t_start:g} to {self._t_end:g} s>"

    def _repr_html_(self) -> str:
        """For notebooks: the table that `phfmu run` prints."""
        from .report import audit_table

        return f"<pre>{escape(audit_table(self.summary()))}</pre>"

    def add(
        self,
        booking: Booking,
        step: ArrayLike,
        t0: ArrayLike,
        h: ArrayLike,
        steps: Steps,
        H0: ArrayLike | None = None,
    ) -> None:
        """Book n accepted steps; shapes and errors as for `make_block`, which copies the arrays."""
        block = make_block(booking, step, t0, h, steps, H0)
        if len(block.step) == 0:
            return
        block = self.take(block)
        if self._sink is not None:
            self._sink.write_block(block)

    def take(self, block: Block) -> Block:
        """Sum and judge a block of at least one step; the block with what only the run knows filled in."""
        stored = self._add_components(block)
        self._add_ports(block)
        self._add_parts(block)
        self._add_network(block.network)
        relative = self._judge.steps(block, stored)
        if self._steps == 0:
            self._t_start = float(block.t0[0])
        self._numbers, before = self._numbers + block.steps.pairs.size + block.steps.stored.size, self._numbers
        if before < LONG <= self._numbers:
            use_compiled()
        self._steps += len(block.step)
        self._t_end = float(block.t0[-1] + block.h[-1])
        return replace(block, relative=relative)

    def _add_components(self, block: Block) -> Floats:
        """Sum the columns of the components; the sums of the changes of H up to each step [n,c]."""
        names, s = block.booking.components, block.steps
        for key, table in {"dissipated": s.dissipated, "supplied": s.supplied, "numerical": s.numerical}.items():
            if table is not None:
                self._sums.add([(key, name) for name in names], table)
        return self._sums.extend([("stored", name) for name in names], s.stored)

    def _add_ports(self, block: Block) -> None:
        booking = block.booking
        widths: dict[tuple[str, str], list[int]] = {}
        for j, port in enumerate(booking.ports):
            self._ports.setdefault((port.component, port.port), (port.junction, port.quality))
            widths.setdefault((port.component, port.port), []).append(j)
            if port.quality == Quality.ESTIMATED and port.junction is not None:
                self._estimated.add(port.junction)
        for width in {len(js) for js in widths.values()}:
            some = {key: js for key, js in widths.items() if len(js) == width}
            pairs = block.steps.pairs
            if width > 1 or len(some) < len(booking.ports):
                pairs = pairs[:, list(some.values())].transpose(0, 2, 1).reshape(-1, len(some))  # steps, pairs, ports
            self._sums.add([("port", *key) for key in some], pairs)
        names = list(booking.junctions)
        self._loose.update(names if booking.loose else ())
        self._sums.add([("junction", name) for name in names], block.junction_residual)
        self._sums.add([("exchanged", name) for name in names], block.junction_exchanged)
        for j, name in enumerate(names):
            self._junctions[name] = larger(self._junctions.get(name, 0.0), largest(block.junction_residual[:, j]))

    def _add_parts(self, block: Block) -> None:
        works = block.steps.works
        if works is None:
            return
        self._sums.add([("part", key.junction, key.part) for key in block.booking.parts], works)
        for j, key in enumerate(block.booking.parts):
            self._parts[key] = larger(self._parts.get(key, 0.0), largest(works[:, j]))

    def _add_network(self, network: dict[str, Floats]) -> None:
        """Sum the network's columns and put the running sums beside them."""
        self._unexplained = larger(self._unexplained, largest(network["unexplained"]))
        names = [name for name in (*CUMULATIVE, "dH", "numerical") if name in network]
        sums = self._sums.extend([(name,) for name in names], np.stack([network[name] for name in names], axis=1))
        network.update((f"cum_{name}", sums[:, j]) for j, name in enumerate(names) if name in CUMULATIVE)

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
            self._sums["jumps", component].add(energy_jump)
            self._judge.jump(component, energy_jump)
        if self._sink is not None:
            self._sink.write_event(EventRow(t, kind, component, energy_jump, message, lost))

    def contradiction(self, violation: Violation) -> None:
        """Book that rows of a file contradict each other."""
        self._judge.note(violation)

    def flush(self) -> None:
        """Bring everything booked so far to the sink's file; call it before raising an error."""
        if self._sink is not None:
            self._sink.flush()

    def summary(self) -> LedgerSummary:
        """The sums so far and the verdict on them, as plain values."""
        found = self._judge.violations()
        return LedgerSummary(
            self._steps,
            self._t_start,
            self._t_end,
            [self._component(name, found) for name in self._judge.accounts],
            [PortSummary(*key, *kept, self._sums.get("port", *key) or 0.0) for key, kept in self._ports.items()],
            [self._junction(name, worst, found) for name, worst in self._junctions.items()],
            [
                PartSummary(key.junction, key.part, self._sums.get("part", key.junction, key.part) or 0.0, worst)
                for key, worst in self._parts.items()
            ],
            self._network(found) if self._steps else None,
            dict(self._events.kinds),
            self._judge.rtol,
            found,
        )

    def _component(self, name: str, found: list[Violation]) -> ComponentSummary:
        get, account = self._sums.get, self._judge.accounts[name]
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
        )

    def _junction(self, name: str, worst: float, found: list[Violation]) -> JunctionSummary:
        get = self._sums.get
        quality = (
            Quality.LOOSE if name in self._loose else Quality.ESTIMATED if name in self._estimated else Quality.EXACT
        )
        verdict = word(found, JUNCTION, name, quality)
        return JunctionSummary(name, get("junction", name) or 0.0, get("exchanged", name), worst, verdict)

    def _network(self, found: list[Violation]) -> NetworkSummary:
        get = self._sums.get
        return NetworkSummary(
            stored=get("dH") or 0.0,
            dissipated=get("dissipated") or 0.0,
            external=get("external"),
            junction_residual=get("junction_residual"),
            unexplained=get("unexplained") or 0.0,
            worst_unexplained=self._unexplained,
            verdict=word(found, (ViolationKind.UNEXPLAINED,), "network", self._judge.quality),
            numerical=get("numerical"),
        )
