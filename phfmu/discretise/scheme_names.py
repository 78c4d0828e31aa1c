"""Names of schemes, gradients and orders that users choose from; imports nothing, so that the command line stays fast."""

SCHEMES = ("auto", "collocated", "two-level", "semi-explicit", "midpoint")
GRADIENTS = ("per-term", "joint-gonzalez", "mean-value", "itoh-abe", "itoh-abe-symmetric")
ORDERS = (2, 4, 6)
