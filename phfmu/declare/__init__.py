"""Declarations: variables, ports, energies, and the frozen PHDAE."""
