"""The names of `phfmu.audit` and where they are defined."""

from phfmu.audit.analysis import audit_table as audit_table
from phfmu.audit.analysis import summarise as summarise
from phfmu.audit.analysis import verdict as verdict
from phfmu.audit.booked_steps import BookedSteps as BookedSteps
from phfmu.audit.booked_steps import book_steps as book_steps
from phfmu.audit.booking import Booking as Booking
from phfmu.audit.booking import PartKey as PartKey
from phfmu.audit.booking import PortKey as PortKey
from phfmu.audit.events import EventRow as EventRow
from phfmu.audit.judge import DEFAULT_RTOL as DEFAULT_RTOL
from phfmu.audit.judge import Judge as Judge
from phfmu.audit.ledger import Ledger as Ledger
from phfmu.audit.ledger import Sink as Sink
from phfmu.audit.log.archive import Recovered as Recovered
from phfmu.audit.log.archive import metadata as metadata
from phfmu.audit.log.archive import read as read
from phfmu.audit.log.archive import recover as recover
from phfmu.audit.log.stream import AuditWriter as AuditWriter
from phfmu.audit.summary import ComponentSummary as ComponentSummary
from phfmu.audit.summary import JunctionSummary as JunctionSummary
from phfmu.audit.summary import LedgerSummary as LedgerSummary
from phfmu.audit.summary import NetworkSummary as NetworkSummary
from phfmu.audit.summary import PartSummary as PartSummary
from phfmu.audit.summary import PortSummary as PortSummary
from phfmu.audit.violation import Violation as Violation

__all__: list[str]
