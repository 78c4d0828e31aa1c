"""System Structure and Parameterization (SSP 1.0 and 2.0): networks of units as other tools exchange them, read and written."""
