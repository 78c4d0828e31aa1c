"""Electrical machines: their data, their operating points, their models."""

from phfmu.listed_names import list_names

list_names(__name__)
