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
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from .block import Block, Layout, make_block
from .events import EventCount
from .judge import COMPONENT, DEFAULT_RTOL, Judge, Violation, word
from .one_step import block_of, junction_rows
from .rows import ESTIMATED, EXACT, ComponentRow, EventRow, JunctionRow, NetworkRow, PortRow
from .sink import Sink
from .summary import ComponentSummary, JunctionSummary, LedgerSummary, NetworkSummary, PortSummary
from .sums import Floats, Sums, larger, largest

#: columns of the network that have running sums beside them
CUMULATIVE = ("dissipated", "external", "junction_residual", "unexplained")


class Ledger:
    """Adds up the steps of a run, judges them, and hands them to an optional sink.

    `add_step` for masters that step in Python, `add_block` for engines that make many steps between reports;
    both give the same sums, bit for bit. `rtol`: allowed residual relative to the energies in play, see `Judge`.
    """

    def __init__(self, sink: Sink | None = None, rtol: float = DEFAULT_RTOL) -> None:
        self._sink = sink
        self._judge = Judge(rtol)
        self._sums = Sums()
        self._ports: dict[tuple[str, str], tuple[str | None, str]] = {}
        self._junctions: dict[str, float] = {}
        self._estimated: set[str] = set()
        self._unexplained = 0.0
        self._steps = 0
        self._t_start = self._t_end = math.nan
        self._events = EventCount()

    def add_step(
        self,
        step: int,
        t0: float,
        h: float,
        components: Sequence[ComponentRow],
        ports: Sequence[PortRow] = (),
        junctions: Sequence[JunctionRow] = (),
        *,
        status: str | None = None,
    ) -> NetworkRow:
        """Book one accepted step from t0 to t0 + h and return its network row.

        Residual and exchange of a junction are those of its ports; `junctions` adds what its solver knows.
        Errors: ValueError for a junction without ports.
        """
        block = block_of(step, t0, h, components, ports)
        joined = junction_rows(block, junctions)
        block = self.take(block)
        network = NetworkRow(**{name: float(column[0]) for name, column in block.network.items()}, status=status)
        if self._sink is not None:
            qualities = [block.layout.quality(row.component) for row in components]
            relative = np.zeros(len(qualities)) if block.relative is None else block.relative[0]
            judged = zip(components, qualities, relative, strict=True)
            booked = [replace(row, quality=quality, relative=float(found)) for row, quality, found in judged]
            self._sink.write_step(step, t0, h, booked, ports, joined, network)
        return network

    def add_block(
        self,
        layout: Layout,
        step: ArrayLike,
        t0: ArrayLike,
        h: ArrayLike,
        H: ArrayLike,
        dH: ArrayLike,
        dissipated: ArrayLike | None = None,
        supplied: ArrayLike | None = None,
        port_energy: ArrayLike | None = None,
        port_u: ArrayLike | None = None,
        port_y: ArrayLike | None = None,
        *,
        H0: ArrayLike | None = None,
        moved: ArrayLike | None = None,
        newton: ArrayLike | None = None,
        substeps: ArrayLike | None = None,
        numerical: ArrayLike | None = None,
    ) -> None:
        """Book n accepted steps at once; shapes and errors as for `make_block`, which copies the arrays."""
        block = make_block(
            layout,
            step,
            t0,
            h,
            H,
            dH,
            dissipated,
            supplied,
            port_energy,
            port_u,
            port_y,
            H0=H0,
            moved=moved,
            newton=newton,
            substeps=substeps,
            numerical=numerical,
        )
        if len(block.step) == 0:
            return
        block = self.take(block)
        if self._sink is not None:
            self._sink.write_block(block)

    def take(self, block: Block) -> Block:
        """Sum and judge a block of at least one step; the block with what only the run knows filled in."""
        stored = self._add_components(block)
        self._add_ports(block)
        self._add_network(block.network)
        relative = self._judge.steps(block, stored)
        if self._steps == 0:
            self._t_start = float(block.t0[0])
        self._steps += len(block.step)
        self._t_end = float(block.t0[-1] + block.h[-1])
        return replace(block, relative=relative)

    def _add_components(self, block: Block) -> Floats:
        """Sum the columns of the components; the sums of dH up to each step [n,c]."""
        names = block.layout.components
        stored = self._sums.extend([("stored", name) for name in names], block.dH)
        tables = {"dissipated": block.dissipated, "supplied": block.supplied, "numerical": block.numerical}
        for key, table in tables.items():
            there = [i for i, name in enumerate(names) if block.layout.has(name, key)]
            if table is not None:
                self._sums.extend([(key, names[i]) for i in there], table[:, there])
        return stored

    def _add_ports(self, block: Block) -> None:
        layout = block.layout
        widths: dict[tuple[str, str], list[int]] = {}
        for j, port in enumerate(layout.ports):
            self._ports.setdefault((port.component, port.port), (port.junction, port.quality))
            widths.setdefault((port.component, port.port), []).append(j)
            if port.quality == ESTIMATED and port.junction is not None:
                self._estimated.add(port.junction)
        for width in {len(js) for js in widths.values()}:
            some = {key: js for key, js in widths.items() if len(js) == width}
            pairs = block.port_energy[:, list(some.values())]  # steps, ports, pairs
            self._sums.extend([("port", *key) for key in some], pairs.transpose(0, 2, 1).reshape(-1, len(some)))
        names = list(layout.junctions)
        self._sums.extend([("junction", name) for name in names], block.junction_residual)
        self._sums.extend([("exchanged", name) for name in names], block.junction_exchanged)
        for j, name in enumerate(names):
            self._junctions[name] = larger(self._junctions.get(name, 0.0), largest(block.junction_residual[:, j]))

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
    ) -> None:
        """Book something between the last step and the next; energy_jump [J] is what it added to the component's H."""
        self._events.add(t, kind, component, message)
        if component is not None and energy_jump is not None:
            self._sums["jumps", component].add(energy_jump)
            self._judge.jump(component, energy_jump)
        if self._sink is not None:
            self._sink.write_event(EventRow(t, kind, component, energy_jump, message))

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
            dissipated=get("dissipated", name),
            supplied=get("supplied", name),
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
        get, quality = self._sums.get, ESTIMATED if name in self._estimated else EXACT
        verdict = word(found, ("junction",), name, quality)
        return JunctionSummary(name, get("junction", name) or 0.0, get("exchanged", name), worst, verdict)

    def _network(self, found: list[Violation]) -> NetworkSummary:
        get = self._sums.get
        return NetworkSummary(
            stored=get("dH") or 0.0,
            dissipated=get("dissipated"),
            external=get("external"),
            junction_residual=get("junction_residual"),
            unexplained=get("unexplained") or 0.0,
            worst_unexplained=self._unexplained,
            verdict=word(found, ("unexplained",), "network", self._judge.quality),
            numerical=get("numerical"),
        )
