"""What is wrong with a declaration: all problems at once, each with its remedy."""
