"""Where the program `follow` begins: Ctrl-C in the half second of its imports also ends in one line."""

import sys


def main() -> int:
    """Import the program and run it; returns the exit status."""
    try:
        from follow.cli.program import main as run  # noqa: PLC0415 - that is what may be interrupted
    except KeyboardInterrupt:
        sys.stderr.write("follow: error: stopped before it was done (Ctrl-C)\n")
        return 1
    return run()
