"""Event localisation for steps that coupled members take together: steps that end on zeros of guards, and the jumps there."""
