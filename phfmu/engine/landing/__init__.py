"""Event localisation in Python: steps that end on zeros of guards, and the jumps there."""
