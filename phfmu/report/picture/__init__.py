"""Pictures of signals: panels, choice, labels, PNG and HTML."""
