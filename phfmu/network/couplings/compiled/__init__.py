"""The co-simulation master in compiled code: its tables, its members and its threads."""
