"""Electrical components: machines, lines, loads, sources, switches; currents count into the component."""

from phfmu.listed_names import list_names

list_names(__name__)
