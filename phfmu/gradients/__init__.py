"""Discrete gradients and Jacobians of functions: mathematics only."""
