"""State events as tables and numbers: guards and jumps of a plan, their zeros within a step, impulses."""
