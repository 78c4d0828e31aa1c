"""Files that a unit brings along to be tried with: parameter sets, experiments and their results (FMI-LS-REF)."""
