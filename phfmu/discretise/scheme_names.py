"""Names of schemes, gradients and orders that users choose from; imports nothing, so that the command line stays fast."""

SCHEMES = ("auto", "collocated", "two-level", "semi-explicit", "gradient-pair", "dirac-dissipative", "midpoint")
GRADIENTS = ("per-term", "joint-gonzalez", "mean-value", "itoh-abe", "itoh-abe-symmetric")
CLOSURES = ("end", "start", "midpoint", "minimal")
ORDERS = (2, 4, 6)
