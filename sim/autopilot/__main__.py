"""`python -m sim.autopilot`."""

from sim.autopilot.program import main

main()
