"""Reverse sweep over a run: its stretches as they were taken, and bars that go back over them."""
