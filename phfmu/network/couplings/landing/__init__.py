"""State events of members stepped apart: all members end their steps together."""
