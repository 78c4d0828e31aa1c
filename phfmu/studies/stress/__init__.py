"""Stiff and extreme cases: what happens, the criterion, and whether it is met."""
