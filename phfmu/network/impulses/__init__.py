"""Impulses between members stepped apart: at starts, at events, and through junctions."""
