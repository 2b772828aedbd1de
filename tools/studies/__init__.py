"""Studies behind the numbers in docs/."""
