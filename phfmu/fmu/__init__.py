"""Functional Mock-up Units: `export` writes them, FMUInstance steps them."""

from phfmu.listed_names import list_names

list_names(__name__)
