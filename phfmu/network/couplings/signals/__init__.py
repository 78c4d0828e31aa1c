"""Signals between members stepped apart that no row of the interface holds: held, extrapolated or iterated to agreement."""
