"""Verbs that read what a run left: its table, its audit, its page."""
