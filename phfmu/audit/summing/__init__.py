"""Sums of the ledger: compensated, with the same bits by arrays and in compiled code."""
