"""Mechanical components: particles, springs, dampers, inertias and shafts, contacts, and builders of
systems of particles and of mechanisms."""

from phfmu.listed_names import list_names

list_names(__name__)
