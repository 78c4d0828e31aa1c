"""Members at their limits: stiff couplings, loops, crashes, units of other tools."""
