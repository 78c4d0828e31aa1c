"""What takes the rows of a ledger."""

from typing import Protocol

from .booked_steps import BookedSteps
from .events import EventRow


class Sink(Protocol):
    """Where rows go while the run is under way; `AuditWriter` is one."""

    def write_steps(self, block: BookedSteps) -> None: ...

    def write_event(self, event: EventRow) -> None: ...

    def flush(self) -> None: ...
