"""Ports of a unit: told by its user or by its terminals, their values, what they exchange in a step."""
