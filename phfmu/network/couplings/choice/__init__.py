"""Choice of a coupling for a network: by its name or by what fits, members composed or apart, and the order that follows."""
