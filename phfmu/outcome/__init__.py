"""What a step says: its outcome, the failure that carries it, and what is known of accepted steps."""
