"""The energy audit: ledger rows and their closure, the crash-safe log, the report."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.audit.analysis import audit_table, summarise, verdict
    from phfmu.audit.booked_steps import BookedSteps, book_steps
    from phfmu.audit.booking import Booking, PartKey, PortKey
    from phfmu.audit.events import EventRow
    from phfmu.audit.judge import DEFAULT_RTOL, Judge
    from phfmu.audit.ledger import Ledger, Sink
    from phfmu.audit.log.archive import Recovered, metadata, read, recover
    from phfmu.audit.log.stream import AuditWriter
    from phfmu.audit.summary import (
        ComponentSummary,
        JunctionSummary,
        LedgerSummary,
        NetworkSummary,
        PartSummary,
        PortSummary,
    )
    from phfmu.audit.violation import Violation

_HOME = {
    "analysis": ("audit_table", "summarise", "verdict"),
    "log.archive": ("Recovered", "metadata", "read", "recover"),
    "booked_steps": ("BookedSteps", "book_steps"),
    "booking": ("Booking", "PartKey", "PortKey"),
    "judge": ("DEFAULT_RTOL", "Judge"),
    "ledger": ("Ledger", "Sink"),
    "events": ("EventRow",),
    "log.stream": ("AuditWriter",),
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
