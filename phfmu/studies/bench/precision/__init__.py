"""A comparison of error against run time: problem, candidates of this package and of others, files."""
