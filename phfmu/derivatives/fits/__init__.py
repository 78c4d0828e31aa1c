"""Fits of a model to measurements: the fit, its journal, its picture."""
