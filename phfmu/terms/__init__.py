"""Terms: the parts of a declaration as canonical local functions, and the consequences of their structure."""
