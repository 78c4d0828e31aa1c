"""Declarations of components and scenes, written against the public names of phfmu only."""
