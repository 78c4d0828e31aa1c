"""Plans: spaces, kernels and their addresses, sums of products, elimination order; no scheme by name."""
