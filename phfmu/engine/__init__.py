"""Engines: the Python reference, the native runtime, and the compiler that builds it."""
