"""Mechanisms beside other multibody programs: one description in numbers, from which every peer's model is made."""
