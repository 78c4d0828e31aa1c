"""Checks of a declaration: all problems at once, each with its remedy."""
