"""Names of schemes, closures and orders that users choose from; imports nothing, so that the command line stays fast."""

SCHEMES = (
    "auto",
    "collocated",
    "two-level",
    "semi-explicit",
    "gradient-pair",
    "dirac-dissipative",
    "midpoint",
    "radau",
)
CLOSURES = ("end", "start", "midpoint", "minimal")
#: even orders are those of Gauss nodes, odd ones those of Radau nodes
ORDERS = (1, 2, 3, 4, 5, 6)
