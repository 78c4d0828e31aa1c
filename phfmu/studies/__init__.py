"""Studies of the package itself: benchmarks beside peers, and stiff or extreme cases."""
