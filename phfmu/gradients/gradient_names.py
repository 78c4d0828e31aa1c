"""Names of discrete gradients that users choose from; imports nothing, so that the command line stays fast."""

GRADIENTS = ("per-term", "joint-gonzalez", "mean-value", "itoh-abe", "itoh-abe-symmetric")
