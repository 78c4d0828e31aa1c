"""The audit log: its columns, the stream written during a run, and the archive read back."""
