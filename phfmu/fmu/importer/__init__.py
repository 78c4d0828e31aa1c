"""Units read: archives, descriptions, ports, and instances behind FMPy's bindings."""
