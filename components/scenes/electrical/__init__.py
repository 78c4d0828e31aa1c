"""Scenes of machines, lines and grids."""

from phfmu.listed_names import list_names

list_names(__name__)
