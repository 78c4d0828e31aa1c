"""The rows of one step as a block of one step."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from .block import Block, Layout, PortKey, make_block
from .rows import SILENT, ComponentRow, JunctionRow, PortRow


def block_of(step: int, t0: float, h: float, components: Sequence[ComponentRow], ports: Sequence[PortRow]) -> Block:
    """One step's rows as a block."""
    absent = {
        (row.component, name)
        for row in components
        for name in ("dissipated", "supplied", "numerical")
        if getattr(row, name) is None
    }
    layout = Layout(
        tuple(row.component for row in components),
        tuple(PortKey(r.component, r.port, r.index, r.junction, r.kind, r.quality) for r in ports),
        frozenset(row.component for row in components if row.quality == SILENT),
        frozenset(absent),
    )

    def column(name: str) -> list[list[float]] | None:
        values = [getattr(row, name) for row in components]
        return None if all(v is None for v in values) else [[v or 0.0 for v in values]]

    moved = [[max(abs(r.H0), abs(r.H1)) if r.moved is None else r.moved for r in components]]
    H0, H1, dH = ([[getattr(row, name) for row in components]] for name in ("H0", "H1", "dH"))
    return make_block(
        layout, [step], [t0], h, H1, dH, column("dissipated"), column("supplied"), [[row.supplied for row in ports]],
        H0=H0, moved=moved, numerical=column("numerical"),
    )  # fmt: skip


def junction_rows(block: Block, known: Iterable[JunctionRow]) -> list[JunctionRow]:
    """A row for every junction of a block of one step, with what its solver knows."""
    rows = {row.junction: row for row in known}
    for name in rows:
        if name not in block.layout.junctions:
            raise ValueError(f"junction {name!r} has no port in this step; give one")
    return [
        replace(rows.get(name, JunctionRow(name)), residual=float(r), exchanged=float(e))
        for name, r, e in zip(
            block.layout.junctions, block.junction_residual[0], block.junction_exchanged[0], strict=True
        )
    ]
