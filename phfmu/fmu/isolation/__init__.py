"""Units that hang, exit or crash: watched in this process, or run in one of their own."""
