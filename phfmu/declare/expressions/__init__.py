"""Expressions of a declaration: their operations, sums taken apart, dimensions and units."""
