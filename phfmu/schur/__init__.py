"""The Schur stepper of constrained particles: what a model must be like, its tables, its functions as C."""
