"""From a declaration to plans: discrete gradients, schemes, and the planner."""
