"""Scenes: networks with their step, stop time and events."""
