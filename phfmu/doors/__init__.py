"""Runs and steps as functions of other tools, with their derivatives: CasADi, JAX, PyTorch, and NumPy for SciPy."""
