"""Steps from event to event of a run: equal steps, steps that keep a tolerance, steps that end on events, restart steps."""
