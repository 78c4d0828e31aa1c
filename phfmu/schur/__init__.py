"""The Schur stepper of constrained particles: its conditions, its tables, its functions as C."""
