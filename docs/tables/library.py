"""Table of docs/results/orders.md."""

from __future__ import annotations

from pages import PageBlock

from phfmu.studies.bench.orders import measure
from phfmu.studies.bench.orders import table as markdown


def orders() -> PageBlock:
    """Slopes and worst ledger closure of every scheme on everything in the library."""
    return PageBlock(markdown(measure()))
