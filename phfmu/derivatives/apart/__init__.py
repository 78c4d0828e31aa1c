"""Derivatives of runs of members stepped apart: the implicit function theorem on each member's step, and on the interface."""
