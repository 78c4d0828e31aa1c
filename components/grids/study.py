"""Fault studies of grids as scenes."""


def grid_scene(): ...
