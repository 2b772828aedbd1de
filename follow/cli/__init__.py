"""The command line: one file a command, the settings, and the only place that builds cameras and links.

May import everything, also the simulator.
"""
