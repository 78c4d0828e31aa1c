"""Extraction of the terms of a declaration: energies, flows, masses."""
