"""Where every joule went: ledger rows and their closure, the crash-safe log, the report."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .analysis import summarise, verdict
    from .archive import Recovered, metadata, read, recover
    from .booked_steps import BookedSteps, book_steps
    from .booking import Booking, PartKey, PortKey
    from .events import EventRow
    from .judge import DEFAULT_RTOL, Judge
    from .ledger import Ledger
    from .report import audit_table
    from .sink import Sink
    from .stream import AuditWriter
    from .summary import ComponentSummary, JunctionSummary, LedgerSummary, NetworkSummary, PartSummary, PortSummary
    from .violation import Violation

_HOME = {
    "analysis": ("summarise", "verdict"),
    "archive": ("Recovered", "metadata", "read", "recover"),
    "booked_steps": ("BookedSteps", "book_steps"),
    "booking": ("Booking", "PartKey", "PortKey"),
    "judge": ("DEFAULT_RTOL", "Judge"),
    "ledger": ("Ledger",),
    "report": ("audit_table",),
    "events": ("EventRow",),
    "sink": ("Sink",),
    "stream": ("AuditWriter",),
    "summary": (
        *("ComponentSummary", "JunctionSummary", "LedgerSummary", "NetworkSummary", "PartSummary"),
        "PortSummary",
    ),
    "violation": ("Violation",),
}

__all__ = [
    "DEFAULT_RTOL",
    "AuditWriter",
    "BookedSteps",
    "Booking",
    "ComponentSummary",
    "EventRow",
    "Judge",
    "JunctionSummary",
    "Ledger",
    "LedgerSummary",
    "NetworkSummary",
    "PartKey",
    "PartSummary",
    "PortKey",
    "PortSummary",
    "Recovered",
    "Sink",
    "Violation",
    "audit_table",
    "book_steps",
    "metadata",
    "read",
    "recover",
    "summarise",
    "verdict",
]


def __getattr__(name: str) -> Any:
    for module, names in _HOME.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
