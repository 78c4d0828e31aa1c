"""Vetting of units of other tools: each claim of a description is tried, in a process of its own."""
