"""The page of a run: diagram, flows of energy, books and verdict."""
