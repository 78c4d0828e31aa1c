"""Schemes: the unknowns of a step and the kernels of its terms, one file each."""
