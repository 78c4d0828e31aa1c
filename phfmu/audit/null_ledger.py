"""No ledger: the place of one in runs that keep none."""

from typing import Any

from phfmu.audit.summary import LedgerSummary


class NullLedger:
    """Takes what a `Ledger` takes and keeps nothing; its summary is that of no steps."""

    CARRIED = ()

    def add(self, *block: Any) -> None: ...

    def event(self, *row: Any, **more: Any) -> None: ...

    def flush(self) -> None: ...

    def summary(self) -> LedgerSummary:
        return LedgerSummary()
