"""Outcomes of steps, the failures that carry them, and the records of accepted steps."""
