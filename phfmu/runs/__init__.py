"""Runs: from event to event, with the books and the rows."""
