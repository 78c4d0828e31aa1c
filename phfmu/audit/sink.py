"""What takes the rows of a ledger."""

from collections.abc import Sequence
from typing import Protocol

from .block import Block
from .rows import ComponentRow, EventRow, JunctionRow, NetworkRow, PortRow


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
