"""Terms: what a declaration consists of, as canonical local functions, and what follows from their structure."""
