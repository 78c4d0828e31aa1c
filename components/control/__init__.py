"""Controllers: signals in, signals out, no power."""
