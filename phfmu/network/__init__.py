"""Networks: members, junctions, couplings and runs."""
