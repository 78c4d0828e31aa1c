"""From plans to libraries: C text, the tables of the runtime, the compiler and its cache."""
