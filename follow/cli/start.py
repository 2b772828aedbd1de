"""Entry point of the program `follow`: Ctrl-C in the half second of its imports also gives a one-line error."""

import sys


def main() -> int:
    """Import the program and run it; returns the exit status."""
    try:
        from follow.cli.program import main as run  # noqa: PLC0415 - that is what may be interrupted
    except KeyboardInterrupt:
        sys.stderr.write("follow: error: stopped before it was done (Ctrl-C)\n")
        return 1
    return run()
