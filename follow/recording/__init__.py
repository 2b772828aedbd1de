"""Records a flight: ticks in, `flight.rrd`, `ticks.csv`, `settings.toml` and `summary.json` out; scores and viewer.

May import: messages, geometry, ranges and the tracker's evaluation.  Consumes the loop's ticks; the loop does not know
about it.
"""
