"""Errors of this project that a caller may want to tell from others."""


class UsageError(ValueError):
    """What was asked for cannot be done; the message is one sentence for a person."""
