"""Rows of a log that say other than what follows from the others."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from phfmu.audit.booked_steps import BookedSteps
from phfmu.audit.judge import EPS, ULPS
from phfmu.audit.kinds import RowKind
from phfmu.audit.ledger import Ledger
from phfmu.audit.log.reading import InternedNames, LogRows
from phfmu.audit.summing.sums import Floats
from phfmu.audit.violation import Violation, ViolationKind
from phfmu.words import counted


class Contradictions:
    """Holds recorded rows against the block that was made of them and judged again; tells the ledger what differs."""

    def __init__(self, ledger: Ledger, interned: InternedNames) -> None:
        self._ledger, self._name = ledger, interned.name
        self._played = 0.0  # sum of all energies in play so far

    def hold(self, block: BookedSteps, tables: Mapping[RowKind, tuple[LogRows, int]]) -> None:
        """Compare what the rows say with what follows from the others."""
        size = np.nan_to_num(block.in_play, posinf=0.0).sum(axis=1)
        size += np.nan_to_num(np.abs(block.steps.pairs), posinf=0.0).sum(axis=1)
        if RowKind.COMPONENT in tables:
            rows, c = tables[RowKind.COMPONENT]
            for i, name in enumerate(block.booking.components):
                part = rows.take(slice(i, None, c))
                self._same(block, f"component {name}", part, "residual", block.residual[:, i], size)
                self._scale(block, f"component {name}", part, i)
                self._same(block, f"component {name}", part, "t0", block.t0, np.abs(block.t0))
                self._same(block, f"component {name}", part, "h", block.h, np.abs(block.h))
        self._junctions(block, tables.get(RowKind.JUNCTION), size)
        network = tables[RowKind.NETWORK][0]
        played = self._played + np.cumsum(size)
        self._played = float(played[-1])
        for column, values in block.network.items():
            scale = (
                played
                if column.startswith("cum_")
                else size + (np.abs(block.steps.H).sum(axis=1) if column == "H" else 0.0)
            )
            self._same(block, "network", network, column, values, scale)

    def _scale(self, block: BookedSteps, where: str, rows: LogRows, i: int) -> None:
        """The scale of a residual holds the recorded `moved`: the recorded ratio must be made with it."""
        assert block.relative is not None
        relative = block.relative[:, i]
        self._same(block, where, rows, "residual_rel", relative, np.abs(relative))
        bare = np.flatnonzero(rows.numbers["moved"][1] & ~rows.numbers["residual_rel"][1])
        if len(bare):
            step = int(block.step[bare[0]])
            self.tell(step, f"{where}: the row of step {step} says moved without residual_rel", steps=len(bare))

    def _junctions(self, block: BookedSteps, table: tuple[LogRows, int] | None, size: Floats) -> None:
        step = int(block.step[0])
        named = [] if table is None else [self._name(code) for code in table[0].names["junction"][: table[1]]]
        if sorted(map(str, named)) != sorted(block.booking.junctions):
            there, told = ", ".join(map(str, named)) or "none", ", ".join(block.booking.junctions) or "none"
            self.tell(step, f"step {step} has rows of the junctions {there}; by its ports there are {told}")
            return
        for j, name in enumerate(block.booking.junctions):
            assert table is not None
            part = table[0].take(slice(named.index(name), None, table[1]))
            self._same(block, f"junction {name}", part, "residual", block.junction_residual[:, j], size)
            self._same(block, f"junction {name}", part, "exchanged", block.junction_exchanged[:, j], size)

    def _same(self, block: BookedSteps, where: str, rows: LogRows, column: str, derived: Floats, size: Floats) -> None:
        """A violation where a row's column differs from what follows from other rows by more than rounding."""
        said, there = rows.numbers[column]
        with np.errstate(invalid="ignore", over="ignore"):
            allowed = ULPS * EPS * size
            bad = there & ~(np.abs(said - derived) <= allowed) & (np.isfinite(said) | np.isfinite(derived))
        if bad.any():
            k = int(np.argmax(bad))
            self.tell(
                int(block.step[k]),
                f"{where}: the row of step {block.step[k]} says {column} = {said[k]:.9g}; the other rows make {derived[k]:.9g}",
                float(said[k] - derived[k]),
                float(allowed[k]),
                int(bad.sum()),
            )

    def held(self, footer: Mapping[str, Any]) -> None:
        """Compare what is there with what the footer says; a run that ends later than its rows has lost its last ones."""
        found = self._ledger.summary()
        steps, end = footer.get("steps", found.steps), footer.get("end")
        there = f"there are {counted(found.steps, 'step')}" + (f" to t = {found.t_end:.9g} s" if found.steps else "")
        same = end is None or (found.steps and abs(end - found.t_end) <= ULPS * EPS * abs(end))
        if steps != found.steps or not same:
            said = f"{counted(steps, 'step')}" + ("" if end is None else f" to t = {end:.9g} s")
            self.tell(found.steps, f"the footer: it says that the log holds {said}; {there}")

    def tell(self, step: int, note: str, size: float = math.nan, allowed: float = 0.0, steps: int = 1) -> None:
        where = note.split(":")[0]
        self._ledger.contradiction(
            Violation(ViolationKind.FILE, where, step, math.nan, math.nan, size, allowed, steps, note)
        )
