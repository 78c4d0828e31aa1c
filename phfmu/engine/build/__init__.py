"""Building of libraries from plans: C text, the tables of the runtime, the compiler and its cache."""
