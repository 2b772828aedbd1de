"""Control: where the target is (`target`), and the velocity that keeps it in view (`servo`).

May import: messages, geometry, ranges and the tracker's library.  No I/O and no clock.
"""
