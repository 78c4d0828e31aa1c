"""One step in Python: the readable twin of the compiled runtime."""
