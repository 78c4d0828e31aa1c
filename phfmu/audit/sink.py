"""What takes the rows of a ledger."""

from typing import Protocol

from .block import Block
from .events import EventRow


class Sink(Protocol):
    """Where rows go while the run is under way; `AuditWriter` is one."""

    def write_block(self, block: Block) -> None: ...

    def write_event(self, event: EventRow) -> None: ...

    def flush(self) -> None: ...
