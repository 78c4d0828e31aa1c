"""How a run gets from event to event: equal steps, steps that keep a tolerance, steps that end on events, restart steps."""
