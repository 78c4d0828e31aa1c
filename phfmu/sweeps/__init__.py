"""Many runs of one model: designs, measures, and the table of both."""
