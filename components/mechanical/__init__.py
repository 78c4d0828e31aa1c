"""Mechanical components: particles, springs, dampers, inertias and shafts."""
