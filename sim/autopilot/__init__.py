"""A MAVLink vehicle over UDP with the rules of PX4 or ArduPilot: `python -m sim.autopilot`.

`system` is the MAVLink side without I/O, `core` the behaviour that both autopilots share, `rules` their differences.
"""
