"""Benchmarks: published results reproduced, error against run time."""
