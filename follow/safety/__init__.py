"""The gate: no byte reaches an autopilot but through `Safety.allow`.  One person can review the whole room.

May import: messages, geometry, ranges, control.  Pure functions of their arguments: no I/O, no clock.
"""
