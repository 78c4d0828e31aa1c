"""Schemes: which unknowns a step has and what kernels its terms become, one file each."""
