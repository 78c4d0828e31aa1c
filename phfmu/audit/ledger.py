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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .block import Block, Layout, make_block
from .rows import ESTIMATED, ComponentRow, EventRow, JunctionRow, NetworkRow, PortRow
from .summary import ComponentSummary, JunctionSummary, LedgerSummary, NetworkSummary, PortSummary
from .sums import CompensatedSum, Floats, larger, largest, total


class Sink(Protocol):
    """Where rows go while the run is under way; `AuditWriter` is one."""

    def write_step(
        self,
        step: int,
        t0: float,
        h: float,
        components: Sequence[ComponentRow],
        ports: Sequence[PortRow],
        junctions: Sequence[JunctionRow],
        network: NetworkRow,
    ) -> None: ...

    def write_block(self, block: Block) -> None: ...

    def write_event(self, event: EventRow) -> None: ...

    def flush(self) -> None: ...


class _Sums:
    """Compensated sums by name; one that was never added to is absent."""

    def __init__(self) -> None:
        self._parts: dict[tuple[str, ...], CompensatedSum] = {}

    def __getitem__(self, key: tuple[str, ...]) -> CompensatedSum:
        return self._parts.setdefault(key, CompensatedSum())

    def get(self, *key: str) -> float | None:
        return self._parts[key].value if key in self._parts else None


@dataclass(slots=True)
class _Worst:
    """Where a component did worst, and the ends of its stored energy."""

    H_start: float
    H_end: float = math.nan
    residual: float = 0.0
    relative: float = -1.0
    step: int = 0
    t0: float = math.nan
    magnitude: float = 0.0
    quality: str = "exact"


class Ledger:
    """Adds up the rows of a run and hands them to an optional sink.

    `add_step` for masters that step in Python, `add_block` for engines that make many steps between reports;
    both give the same sums, bit for bit.
    """

    def __init__(self, sink: Sink | None = None) -> None:
        self._sink = sink
        self._sums = _Sums()
        self._worst: dict[str, _Worst] = {}
        self._ports: dict[tuple[str, str], tuple[str | None, str]] = {}
        self._junctions: dict[str, float] = {}
        self._unexplained = 0.0
        self._steps = 0
        self._t_start = self._t_end = math.nan
        self._events: dict[str, int] = {}

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

        Junctions that ports name but `junctions` lacks are derived, as is a residual or exchange left None.
        Errors: ValueError for a junction with neither ports nor a residual.
        """
        booked = _complete(junctions, ports)
        estimated = {row.component for row in ports if row.quality == ESTIMATED}
        if estimated:
            components = [replace(r, quality=ESTIMATED) if r.component in estimated else r for r in components]
        for row in components:
            self._add_component_row(step, t0, row)
        for row in ports:
            self._ports.setdefault((row.component, row.port), (row.junction, row.quality))
            self._sums["port", row.component, row.port].add(row.supplied)
        for row in booked:
            self._sums["junction", row.junction].add(row.residual or 0.0)
            if row.exchanged is not None:
                self._sums["exchanged", row.junction].add(row.exchanged)
            self._junctions[row.junction] = larger(self._junctions.get(row.junction, 0.0), row.residual or 0.0)
        network = self._network_row(components, ports, booked, status)
        self._count(1, t0, t0 + h)
        if self._sink is not None:
            self._sink.write_step(step, t0, h, components, ports, booked, network)
        return network

    def _add_component_row(self, step: int, t0: float, row: ComponentRow) -> None:
        name = row.component
        self._sums["stored", name].add(row.dH)
        if row.dissipated is not None:
            self._sums["dissipated", name].add(row.dissipated)
        if row.supplied is not None:
            self._sums["supplied", name].add(row.supplied)
        if row.numerical is not None:
            self._sums["numerical", name].add(row.numerical)
        worst = self._worst.setdefault(name, _Worst(H_start=row.H0))
        worst.H_end = row.H1
        worst.magnitude = larger(worst.magnitude, row.magnitude)
        if row.quality == ESTIMATED:
            worst.quality = ESTIMATED
        ratio = row.relative
        if ratio > worst.relative:
            worst.residual, worst.relative, worst.step, worst.t0 = row.residual, ratio, step, t0

    def _network_row(
        self,
        components: Sequence[ComponentRow],
        ports: Sequence[PortRow],
        junctions: Sequence[JunctionRow],
        status: str | None,
    ) -> NetworkRow:
        inside = {row.component for row in components}
        dissipated = total(row.dissipated for row in components if row.dissipated is not None)
        numerical = total(row.numerical for row in components if row.numerical is not None)
        external = total(
            row.supplied if row.component in inside else -row.supplied
            for row in ports
            if (row.component in inside) == (row.junction is None)
        )
        residual = total(row.residual for row in junctions if row.residual is not None)
        dH = total(row.dH for row in components) or 0.0
        unexplained = (dH + (dissipated or 0.0) + (numerical or 0.0) - (external or 0.0)) - (residual or 0.0)
        self._unexplained = larger(self._unexplained, unexplained)
        self._sums["dH",].add(dH)
        if numerical is not None:
            self._sums["numerical",].add(numerical)
        return NetworkRow(
            H=total(row.H1 for row in components) or 0.0,
            dH=dH,
            dissipated=dissipated,
            external=external,
            junction_residual=residual,
            unexplained=unexplained,
            cum_dissipated=None if dissipated is None else self._sums["dissipated",].add(dissipated),
            cum_external=None if external is None else self._sums["external",].add(external),
            cum_junction_residual=None if residual is None else self._sums["junction_residual",].add(residual),
            cum_unexplained=self._sums["unexplained",].add(unexplained),
            status=status,
            numerical=numerical,
        )

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
        scale: ArrayLike | None = None,
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
            scale=scale,
            newton=newton,
            substeps=substeps,
            numerical=numerical,
        )
        n = len(block.step)
        if n == 0:
            return
        self._add_columns(block)
        self._add_network(block.network)
        self._count(n, float(block.t0[0]), float(block.t0[-1] + block.h[-1]))
        if self._sink is not None:
            self._sink.write_block(block)

    def _add_columns(self, block: Block) -> None:
        layout = block.layout
        for i, name in enumerate(layout.components):
            self._sums["stored", name].extend(block.dH[:, i])
            if block.dissipated is not None:
                self._sums["dissipated", name].extend(block.dissipated[:, i])
            if block.supplied is not None:
                self._sums["supplied", name].extend(block.supplied[:, i])
            if block.numerical is not None:
                self._sums["numerical", name].extend(block.numerical[:, i])
            worst = self._worst.setdefault(name, _Worst(H_start=float(block.H0[0, i])))
            worst.H_end = float(block.H1[-1, i])
            worst.magnitude = larger(worst.magnitude, largest(block.magnitude[:, i]))
            if name in layout.estimated:
                worst.quality = ESTIMATED
            k = int(np.argmax(block.relative[:, i]))
            if block.relative[k, i] > worst.relative:
                worst.residual, worst.relative = float(block.residual[k, i]), float(block.relative[k, i])
                worst.step, worst.t0 = int(block.step[k]), float(block.t0[k])
        widths: dict[tuple[str, str], list[int]] = {}
        for j, port in enumerate(layout.ports):
            self._ports.setdefault((port.component, port.port), (port.junction, port.quality))
            widths.setdefault((port.component, port.port), []).append(j)
        for key, js in widths.items():
            self._sums["port", *key].extend(block.port_energy[:, js].ravel())
        for j, name in enumerate(layout.junctions):
            self._sums["junction", name].extend(block.junction_residual[:, j])
            self._sums["exchanged", name].extend(block.junction_exchanged[:, j])
            worst_of_block = largest(block.junction_residual[:, j])
            self._junctions[name] = larger(self._junctions.get(name, 0.0), worst_of_block)

    def _add_network(self, network: dict[str, Floats]) -> None:
        """Sum the network's columns and put the running sums beside them."""
        self._unexplained = larger(self._unexplained, largest(network["unexplained"]))
        self._sums["dH",].extend(network["dH"])
        if "numerical" in network:
            self._sums["numerical",].extend(network["numerical"])
        for name in ("dissipated", "external", "junction_residual", "unexplained"):
            if name in network:
                network[f"cum_{name}"] = self._sums[name,].extend(network[name])

    def event(
        self,
        t: float,
        kind: str,
        component: str | None = None,
        energy_jump: float | None = None,
        message: str | None = None,
    ) -> None:
        """Book something outside the steps; energy_jump [J] is what it added to the component's H."""
        self._events[kind] = self._events.get(kind, 0) + 1
        if component is not None and energy_jump is not None:
            self._sums["jumps", component].add(energy_jump)
        if self._sink is not None:
            self._sink.write_event(EventRow(t, kind, component, energy_jump, message))

    def flush(self) -> None:
        """Bring everything booked so far to the sink's file; call it before raising an error."""
        if self._sink is not None:
            self._sink.flush()

    def _count(self, n: int, t_start: float, t_end: float) -> None:
        if self._steps == 0:
            self._t_start = t_start
        self._steps += n
        self._t_end = t_end

    def summary(self) -> LedgerSummary:
        """The sums so far, as plain values."""
        get = self._sums.get
        components = [
            ComponentSummary(
                name,
                worst.H_start,
                worst.H_end,
                stored=get("stored", name) or 0.0,
                dissipated=get("dissipated", name),
                supplied=get("supplied", name),
                jumps=get("jumps", name),
                worst_residual=worst.residual,
                worst_relative=worst.relative,
                worst_step=worst.step,
                worst_t0=worst.t0,
                magnitude=worst.magnitude,
                quality=worst.quality,
                numerical=get("numerical", name),
            )
            for name, worst in self._worst.items()
        ]
        ports = [
            PortSummary(component, port, junction, quality, get("port", component, port) or 0.0)
            for (component, port), (junction, quality) in self._ports.items()
        ]
        junctions = [
            JunctionSummary(name, get("junction", name) or 0.0, get("exchanged", name), worst)
            for name, worst in self._junctions.items()
        ]
        network = NetworkSummary(
            stored=get("dH") or 0.0,
            dissipated=get("dissipated"),
            external=get("external"),
            junction_residual=get("junction_residual"),
            unexplained=get("unexplained") or 0.0,
            worst_unexplained=self._unexplained,
            numerical=get("numerical"),
        )
        return LedgerSummary(
            self._steps,
            self._t_start,
            self._t_end,
            components,
            ports,
            junctions,
            network if self._steps else None,
            dict(self._events),
        )


def _complete(junctions: Iterable[JunctionRow], ports: Sequence[PortRow]) -> list[JunctionRow]:
    """Every junction given or named by a port, its residual and exchange filled in from the ports."""
    energies: dict[str, list[float]] = {}
    for port in ports:
        if port.junction is not None:
            energies.setdefault(port.junction, []).append(port.supplied)
    rows = {name: JunctionRow(name) for name in energies}
    rows.update((row.junction, row) for row in junctions)
    complete = []
    for name, row in rows.items():
        members = energies.get(name)
        if row.residual is None:
            if members is None:
                raise ValueError(f"junction {name!r} has neither a residual nor a port in this step; give one")
            row = replace(row, residual=total(members))
        if row.exchanged is None and members is not None:
            row = replace(row, exchanged=0.5 * (total(abs(e) for e in members) or 0.0))
        complete.append(row)
    return complete
