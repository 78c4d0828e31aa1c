"""Sums over a run: of components, ports, junctions, parts and the network."""

from collections.abc import Sequence

import numpy as np

from phfmu.audit.booked_steps import BookedSteps
from phfmu.audit.booking import Booking, PartKey, TermKey
from phfmu.audit.kinds import Quality
from phfmu.audit.summing.sums import Floats, Sums, larger, largest, plain

#: columns of the network that have running sums beside them
CUMULATIVE = ("dissipated", "external", "junction_residual", "unexplained")


class RunSums:
    """Compensated sums `by` name, and the largest magnitude of a step at each junction and part, and of what is unexplained."""

    def __init__(self) -> None:
        self.by = Sums()
        self.ports: dict[tuple[str, str], tuple[str | None, Quality]] = {}
        self.junctions: dict[str, float] = {}
        self.parts: dict[PartKey, float] = {}
        self.terms: dict[TermKey, None] = {}
        self.estimated: set[str] = set()
        self.loose: set[str] = set()
        self.unexplained = 0.0
        self._met: Booking | None = None

    def meet(self, booking: Booking) -> None:
        """The entries that are to be added up."""
        if booking is self._met:
            return
        for port in booking.ports:
            self.ports.setdefault((port.component, port.port), (port.junction, port.quality))
            if port.quality == Quality.ESTIMATED and port.junction is not None:
                self.estimated.add(port.junction)
        self.loose.update(booking.junctions if booking.loose else ())
        self._met = booking

    def add(self, block: BookedSteps) -> Floats:
        """Sum the columns; the sums of the changes of H up to each step [n,c]."""
        self.meet(block.booking)
        stored = self._add_components(block)
        self._add_ports(block)
        self._add_parts(block)
        self._add_network(block.network)
        if block.steps.terms is not None:
            self.add_terms(block.booking.terms, block.steps.terms)
        return stored

    def add_terms(self, keys: Sequence[TermKey], values: Floats) -> None:
        """Sum what terms stored or lost (n x terms)."""
        self.terms.update(dict.fromkeys(keys))
        self.by.add([("term", key.component, key.term) for key in keys], values)

    def _add_components(self, block: BookedSteps) -> Floats:
        names, s = block.booking.components, block.steps
        tables = {"stored": s.stored, "dissipated": s.dissipated, "supplied": s.supplied, "numerical": s.numerical}
        tables["gross"] = plain(np.abs(s.pairs), block.booking.owned) if block.booking.ports else None
        told = {key: table for key, table in tables.items() if table is not None}
        sums = self.by.extend([(key, name) for key in told for name in names], np.concatenate([*told.values()], axis=1))
        return sums[:, : len(names)]

    def _add_ports(self, block: BookedSteps) -> None:
        booking, pairs = block.booking, block.steps.pairs
        for width in {len(js) for js in booking.scalars.values()}:
            some = {key: js for key, js in booking.scalars.items() if len(js) == width}
            own = pairs
            if width > 1 or len(some) < len(booking.ports):
                own = pairs[:, list(some.values())].transpose(0, 2, 1).reshape(-1, len(some))  # steps, pairs, ports
            self.by.add([("port", *key) for key in some], own)
        names = list(booking.junctions)
        made = block.junction_residual
        all_three = np.concatenate([made, block.junction_exchanged, np.abs(made)], axis=1)
        self.by.add([(key, name) for key in ("junction", "exchanged", "created") for name in names], all_three)
        for j, name in enumerate(names):
            self.junctions[name] = larger(self.junctions.get(name, 0.0), largest(block.junction_residual[:, j]))

    def _add_parts(self, block: BookedSteps) -> None:
        works = block.steps.works
        if works is None:
            return
        self.by.add([("part", key.junction, key.part) for key in block.booking.parts], works)
        for j, key in enumerate(block.booking.parts):
            self.parts[key] = larger(self.parts.get(key, 0.0), largest(works[:, j]))

    def _add_network(self, network: dict[str, Floats]) -> None:
        """Sum the network's columns and put the running sums beside them."""
        self.unexplained = larger(self.unexplained, largest(network["unexplained"]))
        names = [name for name in (*CUMULATIVE, "dH", "numerical") if name in network]
        sums = self.by.extend([(name,) for name in names], np.stack([network[name] for name in names], axis=1))
        network.update((f"cum_{name}", sums[:, j]) for j, name in enumerate(names) if name in CUMULATIVE)
