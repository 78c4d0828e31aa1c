"""Entries of a declaration in one form: short forms, kinds, matrices of them, and the rules on names, starts and parameters."""
