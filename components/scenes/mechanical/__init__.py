"""Scenes of bodies that move, turn and meet."""

from phfmu.listed_names import list_names

list_names(__name__)
