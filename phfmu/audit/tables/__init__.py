"""The tables of a ledger: as data, as text, as CSV."""
