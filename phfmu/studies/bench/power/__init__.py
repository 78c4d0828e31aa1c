"""Power networks beside DPsim: the same numbers for both, and an independent reference."""
