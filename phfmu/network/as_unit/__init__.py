"""A network whose members stay apart in one unit, joined by the master inside."""
