"""The error of a declaration."""


class DeclarationError(ValueError):
    """The declaration does not fit what is asked of it; the message names the entry, the numbers and the remedy."""
