"""Scenes: networks with their step, stop time and events."""

from phfmu.listed_names import list_names

list_names(__name__)
