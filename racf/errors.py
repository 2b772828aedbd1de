"""Errors of this project that a caller may want to distinguish."""


class UsageError(ValueError):
    """The request cannot be carried out; the message is one sentence for a person."""


class TrackerError(ValueError):
    """A tracker failed; the message names it, the frame, and its error."""


class VideoError(ValueError):
    """A video cannot be read or written; the message is one sentence for a person."""
