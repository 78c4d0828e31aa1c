"""Derivatives of runs: of every row by parameters, starts and held inputs, and what follows from them (fits, modes)."""
