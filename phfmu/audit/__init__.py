"""The energy audit: ledger rows and their closure, the crash-safe log, the report."""

from phfmu.listed_names import list_names

list_names(__name__)
