"""Inputs of a run that follow data: the files, their rows, and what they are between these."""
