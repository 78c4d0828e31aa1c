"""Discretisation of a declaration: instants, models with their plans, consistent starts."""
