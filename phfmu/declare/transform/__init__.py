"""Changes of variables, and what they reduce: singular E, E of constant rank."""
