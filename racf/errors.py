"""Errors of this project that a caller may want to tell from others."""


class UsageError(ValueError):
    """What was asked for cannot be done; the message is one sentence for a person."""


class TrackerError(ValueError):
    """A tracker failed; the message names it, the frame, and what it said."""


class VideoError(ValueError):
    """A video cannot be read or written; the message is one sentence for a person."""
