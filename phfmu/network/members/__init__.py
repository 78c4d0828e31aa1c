"""Members: what a coupling steps apart, an instance of a model or a unit."""
